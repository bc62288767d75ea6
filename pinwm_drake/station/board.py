# SPDX-License-Identifier: MIT
"""The ChArUco board: its drawing at true scale with a ruler, and its corners in a photo.

The frame M of a board lies in its printed face: origin at a corner of the face, x along its rows, y along its columns,
and z into the paper.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from pinwm_drake.errors import ParameterError, require
from pinwm_drake.files import prepare_folder, replacing

RULER = 0.1  # m, length of the ruler that is printed with a board
DEFAULT_DICTIONARY = "DICT_5X5_250"
FEWEST_CORNERS = 8  # in a photo
_SUFFIXES = (".pdf", ".png")
_PAPERS = {"A4": (0.297, 0.21), "A3": (0.42, 0.297), "A2": (0.594, 0.42), "A1": (0.841, 0.594), "A0": (1.189, 0.841)}
_EDGE, _BELOW = 0.01, 0.012  # m, that a printer leaves white, and that the ruler takes
_DPI = 600
_INCH = 0.0254  # m
_SMALL = 2_500_000  # pixels of an image that is looked at in twice its size too
_WINDOW = 0.2  # of a square's side in the photo: half the side of the window in which a corner is refined


@dataclass(frozen=True)
class Board:
    """ChArUco board as it was printed.

    Attributes:
        squares: Numbers of squares along x and y.
        square: Side of a square, m.
        marker: Side of a marker, m.
        dictionary: OpenCV's name of the markers' dictionary.

    Raises:
        ParameterError: A number is out of range, the dictionary is unknown or has too few markers.
    """

    squares: tuple[int, int] = (9, 6)
    square: float = 0.028
    marker: float = 0.021
    dictionary: str = DEFAULT_DICTIONARY

    def __post_init__(self) -> None:
        require("board squares", self.squares, all(3 <= n <= 40 for n in self.squares), "3 to 40 along each side")
        require("board square", self.square, 1e-3 <= self.square <= 1.0, "0.001 to 1 m")
        sides = 0.3 * self.square <= self.marker <= 0.95 * self.square
        require("board marker", self.marker, sides, f"0.3 to 0.95 of the square's {self.square:g} m")
        known = self.dictionary.startswith("DICT_") and hasattr(cv2.aruco, self.dictionary)
        require("board dictionary", self.dictionary, known, "a name of OpenCV, such as DICT_5X5_250")
        markers, needed = len(self._markers().bytesList), self.squares[0] * self.squares[1] // 2
        if markers < needed:
            raise ParameterError(
                f"board dictionary: got {self.dictionary} of {markers} markers; allowed: {needed} or more"
            )

    def _markers(self) -> cv2.aruco.Dictionary:
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    def opencv(self) -> cv2.aruco.CharucoBoard:
        """Return the same board as OpenCV has it."""
        return cv2.aruco.CharucoBoard(self.squares, self.square, self.marker, self._markers())

    @property
    def size(self) -> tuple[float, float]:
        """Sides along x and y, m."""
        return self.squares[0] * self.square, self.squares[1] * self.square

    @property
    def corners_M(self) -> np.ndarray:
        """Inner corners p_M (N, 3) [m] by their numbers."""
        return np.asarray(self.opencv().getChessboardCorners(), float)

    def cells(self) -> list[tuple[float, float, float, float]]:
        """Black rectangles of the face: x, y of the corner nearest to M, width and height, m."""
        board, found = self.opencv(), list[tuple[float, float, float, float]]()
        places = np.array(board.getObjPoints())
        middles = {tuple(np.floor(corners[:, :2].mean(0) / self.square)) for corners in places}
        for column in range(self.squares[0]):
            for row in range(self.squares[1]):
                if (column, row) not in middles:
                    found.append((column * self.square, row * self.square, self.square, self.square))
        markers = self._markers()
        side = markers.markerSize + 2
        cell = self.marker / side
        for number, corners in zip(np.ravel(board.getIds()), places, strict=True):
            bits = cv2.aruco.generateImageMarker(markers, int(number), side, borderBits=1)
            x, y = corners[:, 0].min(), corners[:, 1].min()
            found += [(float(x + j * cell), float(y + i * cell), cell, cell) for i, j in np.argwhere(bits == 0)]
        return found

    def words(self) -> str:
        """The board as the key `board` of a lab.yaml says it."""
        squares = ", ".join(map(str, self.squares))
        return (
            f"{{squares: [{squares}], square: {self.square:g}, marker: {self.marker:g}, dictionary: {self.dictionary}}}"
        )


def paper_of(board: Board) -> tuple[str, float, float]:
    """Smallest paper that takes a board and its ruler: name, width and height, m; "" for none of A4 to A0."""
    width, height = board.size
    for name, (w, h) in _PAPERS.items():
        if width + 2 * _EDGE <= w and height + 2 * _EDGE + _BELOW <= h:
            return name, w, h
    return "", width + 4 * _EDGE, height + 4 * _EDGE + 2 * _BELOW


def draw_board(board: Board, path: Path) -> str:
    """Draw a board at true scale, with a ruler of 100 mm, on the smallest paper that takes it.

    Args:
        board: The board.
        path: File to write, PDF or PNG.

    Returns:
        Name of the paper, such as "A4"; "" for none of A4 to A0.

    Raises:
        InputError: The file cannot be written.
        ParameterError: The file is neither PDF nor PNG.
    """
    require("--board", path, path.suffix.lower() in _SUFFIXES, "a file .pdf or .png")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import PatchCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    paper, width, height = paper_of(board)
    figure = Figure(figsize=(width / _INCH, height / _INCH), dpi=_DPI)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    left, top = 0.5 * (width - board.size[0]), 0.5 * (height - board.size[1] - _BELOW)
    axes.set(xlim=(-left, width - left), ylim=(height - top, -top))  # M: metres, y down
    axes.set_axis_off()
    black = [Rectangle((x, y), w, h) for x, y, w, h in board.cells()]
    # Cells of one marker touch: without edges and with snapping to pixels there is no seam.
    axes.add_collection(PatchCollection(black, facecolor="black", edgecolor="none", linewidth=0, antialiased=False))
    start, line = board.size[1] + 0.4 * _BELOW, board.size[1] + 0.75 * _BELOW
    ticks = RULER * np.arange(11) / 10
    axes.plot([0, RULER], [line, line], color="black", linewidth=0.6, solid_capstyle="butt")
    for k, x in enumerate(ticks):
        axes.plot([x, x], [line, start if k % 10 == 0 else 0.5 * (start + line)], color="black", linewidth=0.6)
    words = "100 mm between the outer marks: measure them, and put the length into lab.yaml (ruler)"
    axes.text(RULER + 0.004, line, f"{words}\nboard: {board.words()}", fontsize=5, va="bottom", ha="left")
    prepare_folder(path.parent)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=_DPI)
    return paper


@dataclass(frozen=True, eq=False)
class Seen:
    """Corners of a board in a photo.

    Attributes:
        numbers: (n,) int, numbers of the corners.
        pixels: (n, 2) px, the centre of the first pixel at (0.5, 0.5).
    """

    numbers: np.ndarray
    pixels: np.ndarray


class Detector:
    """Detector of a board in photos."""

    def __init__(self, board: Board) -> None:
        self._board = board
        about = cv2.aruco.DetectorParameters()
        about.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        about.perspectiveRemovePixelPerCell = 8
        self._detector = cv2.aruco.CharucoDetector(board.opencv(), cv2.aruco.CharucoParameters(), about)

    def find(self, grey: np.ndarray) -> Seen | None:
        """Corners in a photo (height, width) uint8; None where there are fewer than 8, or all on one line."""
        numbers, corners = self._detect(grey)
        if len(numbers) < len(self._board.corners_M) and grey.size <= _SMALL:
            # Markers of a few pixels a cell are read more often in an image of twice the size.
            more, twice = self._detect(cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC))
            if len(more) > len(numbers):
                numbers, corners = more, 0.5 * (twice + 0.5) - 0.5
        if len(numbers) < FEWEST_CORNERS:
            return None
        places = self._board.corners_M[numbers][:, :2]
        if np.linalg.matrix_rank(places - places[0], tol=0.5 * self._board.square) < 2:
            return None
        return Seen(numbers, self._refined(grey, numbers, corners))

    def _detect(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Numbers (n,) and corners (n, 2) in OpenCV's pixels."""
        corners, numbers, _, _ = self._detector.detectBoard(grey)
        if numbers is None:
            return np.zeros(0, int), np.zeros((0, 2))
        return np.ravel(numbers), np.reshape(corners, (-1, 2))

    def is_mirrored(self, grey: np.ndarray) -> bool:
        """Flag: a photo (H, W) shows the board in a mirror only."""
        return self.find(grey) is None and self.find(np.ascontiguousarray(grey[:, ::-1])) is not None

    def _refined(self, grey: np.ndarray, numbers: np.ndarray, corners: np.ndarray) -> np.ndarray:
        """Corners (n, 2) refined in windows that a square's size in the photo allows."""
        places = self._board.corners_M[numbers][:, :2] / self._board.square
        apart = np.linalg.norm(places[:, None] - places, axis=-1) == 1.0
        i, j = np.nonzero(np.triu(apart))
        sides = np.linalg.norm(corners[i] - corners[j], axis=1) if len(i) else np.array([0.0])
        window = int(np.clip(_WINDOW * np.quantile(sides, 0.1), 2, 8))
        end = cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4
        start = np.ascontiguousarray(corners, np.float32).reshape(-1, 1, 2)
        found = cv2.cornerSubPix(grey, start.copy(), (window, window), (-1, -1), end).reshape(-1, 2)
        lost = np.linalg.norm(found - corners, axis=1) > window
        return np.where(lost[:, None], corners, found).astype(float) + 0.5
