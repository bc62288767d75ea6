# SPDX-License-Identifier: MIT
import cv2
import numpy as np
import pytest

from pinwm_drake.errors import ParameterError
from pinwm_drake.station.board import RULER, Board, Detector, draw_board, paper_of

PER_METRE = 600 / 0.0254  # px of a drawing


def test_the_drawing_has_true_scale(tmp_path):
    board = Board()
    assert draw_board(board, tmp_path / "board.png") == "A4"
    image = cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_allclose(image.shape, [0.21 * PER_METRE, 0.297 * PER_METRE], atol=1)
    seen = Detector(board).find(image)
    assert len(seen.numbers) == 40
    off = seen.pixels / PER_METRE - board.corners_M[seen.numbers, :2]
    assert np.abs(off - off.mean(0)).max() < 5e-5  # 0.05 mm is a pixel of the drawing
    # The ruler: its outer marks are the only black runs of its height below the board.
    left, top = off.mean(0)
    row = image[round((top + board.size[1] + 0.0055) * PER_METRE)]
    marks = np.flatnonzero(row[: round((left + 0.102) * PER_METRE)] < 128) / PER_METRE
    assert marks.max() - marks.min() == pytest.approx(RULER, abs=3e-4)  # from outer edge to outer edge of the marks


def test_a_pdf_is_drawn_on_the_smallest_paper(tmp_path):
    assert draw_board(Board(), tmp_path / "new/board.pdf") == "A4"
    assert (tmp_path / "new/board.pdf").read_bytes().startswith(b"%PDF")
    assert paper_of(Board((9, 6), 0.04, 0.03))[0] == "A3"
    assert paper_of(Board((20, 20), 0.1, 0.075))[0] == ""
    with pytest.raises(ParameterError, match=r"\.pdf or \.png"):
        draw_board(Board(), tmp_path / "board.svg")


def test_the_cells_are_those_of_opencv():
    board = Board((5, 4), 0.03, 0.024)
    cell = round(0.024 / 7 / 0.03 * 350)  # px, of a marker of 5 x 5 bits and its border, at 350 px a square
    expected = board.opencv().generateImage((5 * 350, 4 * 350), marginSize=0, borderBits=1)
    drawn = np.full(expected.shape, 255, np.uint8)
    for x, y, w, h in board.cells():
        (x0, y0), (x1, y1) = (np.round(np.array(p) / 0.03 * 350).astype(int) for p in ((x, y), (x + w, y + h)))
        drawn[y0:y1, x0:x1] = 0
    assert cell == 40
    assert (drawn != expected).mean() < 1e-3


def test_a_mirrored_board_is_told():
    board = Board()
    image = np.full((480, 640), 255, np.uint8)
    image[50:350, 60:510] = board.opencv().generateImage((450, 300))
    detector = Detector(board)
    assert len(detector.find(image).numbers) == 40
    assert not detector.is_mirrored(image)
    mirrored = np.ascontiguousarray(image[:, ::-1])
    assert detector.find(mirrored) is None
    assert detector.is_mirrored(mirrored)
    assert detector.find(np.full((480, 640), 200, np.uint8)) is None


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        ({"squares": (2, 6)}, "squares"),
        ({"square": 2.0}, "square"),
        ({"marker": 0.028}, "marker"),
        ({"dictionary": "DICT_9X9"}, "dictionary"),
        ({"squares": (40, 40), "dictionary": "DICT_4X4_50"}, "800 or more"),
    ],
)
def test_wrong_boards_are_refused(settings, part):
    with pytest.raises(ParameterError, match=part):
        Board(**settings)
