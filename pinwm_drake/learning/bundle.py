"""A policy bundle: a folder that holds all that a controller needs, and that onnxruntime alone runs.

    policy.onnx       the network: images and the pusher's position in, translation in metres out
    contract.yaml     inputs, outputs and limits (`contract.py`)
    golden.npz        samples with the policy's answers to them when it was exported (`golden.py`)
    provenance.json   the policy's origin; SHA-256 of the other three, and of itself without that

Neither torch nor Stable-Baselines3 nor Drake is imported here.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from pinwm_drake.errors import InputError, ParameterError
from pinwm_drake.learning.contract import VERSIONS, difference, make_contract, upgraded
from pinwm_drake.learning.golden import TOLERANCE, Golden, deviation
from pinwm_drake.learning.runtime import Network
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.learning.spec import PolicySpec, seen_parts

ONNX_FILE, CONTRACT_FILE, GOLDEN_FILE, PROVENANCE_FILE = "policy.onnx", "contract.yaml", "golden.npz", "provenance.json"
HASHED = (ONNX_FILE, CONTRACT_FILE, GOLDEN_FILE)
_AS_WRITTEN = "a bundle that `pinwm export` wrote"


@dataclass(frozen=True, eq=False)
class Bundle:
    """A policy that can be run.

    Attributes:
        spec: Specification of the policy: its inputs and outputs, and its task.
        limits: Limits of the pusher's motion that a controller keeps, whatever the policy asks for.
        contract: Contents of contract.yaml, as `make_contract` describes them.
        provenance: Contents of provenance.json: time, versions, training, and the files' SHA-256.
        sha256: SHA-256 of the provenance, which holds those of the other files: it tells this bundle from all others.
        network: The network of policy.onnx.
    """

    spec: PolicySpec
    limits: SafetyLimits
    contract: dict[str, Any]
    provenance: dict[str, Any]
    sha256: str
    network: Network

    def act(self, image: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """Translation d_W (n,) m of the pusher along the task's n axes over the horizon, at most `max_translation`.

        NaN where the position is NaN; a position outside the box counts as at its wall.

        Args:
            image: (height, width, 3 k) uint8, RGB: the last k images, the oldest first.
            p_WP: (n,) m, world: position of the pusher along the task's axes when the last image was taken.

        Raises:
            StateError: A shape, or the image's type, is another.
        """
        return self.network.run(image, p_WP).astype(float)

    def predict(
        self, observation: Any, state: None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Actions (n,) or (B, n) float32 in [-1, 1]^n and no longer than 1; with the signature of `Policy.predict`.

        Args:
            observation: Observation of one world or of B, as the environment gives it: a dict of which `image` and
                `pusher`, across the box, are used.
            state: Not used.
            episode_start: Not used.
            deterministic: Not used: it always is.

        Raises:
            ParameterError: There is no image or pusher in the observation.
            StateError: Their shapes, or the image's type, are others.
        """
        image, pusher = seen_parts(observation, "image", "pusher")
        low, high = np.array(self.spec.pusher_low), np.array(self.spec.pusher_high)
        p_WP = 0.5 * (low + high) + 0.5 * (high - low) * pusher
        if image.ndim == 3:
            d_W = self.act(image, p_WP)
        else:
            d_W = np.array([self.act(*one) for one in zip(image, p_WP, strict=True)]).reshape(-1, self.spec.action_size)
        return (d_W / self.spec.max_translation).astype(np.float32), None


def is_bundle(folder: Path) -> bool:
    """Flag: a folder is, or was meant to be, a bundle and not the policy that `pinwm train` writes."""
    return any((folder / name).exists() for name in (ONNX_FILE, CONTRACT_FILE, PROVENANCE_FILE))


def read_bundle(folder: Path) -> Bundle:
    """Reads a bundle and checks it: files, SHA-256, contract, network, and its answers to the golden samples.

    Raises:
        InputError: There is none, a file is missing, too many, changed or cut off, of another version, or the files
            do not fit each other.
    """
    if not is_bundle(folder):
        there = "a policy" if (folder / "policy.yaml").exists() else "none there"
        raise InputError(folder, value=there, allowed=_AS_WRITTEN)
    provenance = _provenance(folder / PROVENANCE_FILE)
    for name in sorted(path.name for path in folder.iterdir()):
        if name not in (*HASHED, PROVENANCE_FILE) and not name.startswith("."):
            allowed = f"{', '.join(HASHED)} and {PROVENANCE_FILE} alone, as `pinwm export` wrote them"
            raise InputError(folder / name, value="a file that is not of the bundle", allowed=allowed)
    files = {name: _hashed(folder / name, provenance["files"][name]) for name in HASHED}
    spec, limits, contract = _contract(folder / CONTRACT_FILE, files[CONTRACT_FILE])
    network = Network(files[ONNX_FILE], folder / ONNX_FILE, contract)
    golden = Golden.from_bytes(files[GOLDEN_FILE], folder / GOLDEN_FILE, spec)
    check_golden(folder / GOLDEN_FILE, network, golden)
    return Bundle(spec, limits, contract, provenance, provenance["sha256"], network)


def check_golden(path: Path, network: Network, golden: Golden) -> float:
    """Largest distance of the network's answers from the golden ones, m; raises InputError beyond the tolerance."""
    answers = np.array([network.run(*one) for one in zip(golden.images, golden.p_WP, strict=True)])
    for row, (answer, expected) in enumerate(zip(answers, golden.d_W, strict=True), 1):
        if not (gap := deviation(answer, expected)) <= TOLERANCE:
            value = f"{expected.tolist()} m, where {ONNX_FILE} answers {answer.tolist()} m, {gap:.2g} m off"
            raise InputError(path, row=row, value=value, allowed=f"{TOLERANCE:g} m between the two")
    return deviation(answers, golden.d_W)


def provenance_hash(document: Mapping[str, Any]) -> str:
    """SHA-256 of a provenance without its entry `sha256`; the layout of its file does not count."""
    rest = {name: value for name, value in document.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(path, value="no such file", allowed=_AS_WRITTEN) from error
    except OSError as error:
        raise InputError(path, value=error.strerror, allowed="a file that can be read") from error


def _hashed(path: Path, sha256: str) -> bytes:
    """The content of a file; raises InputError where its SHA-256 is another one."""
    content = _content(path)
    found = hashlib.sha256(content).hexdigest()
    if found != sha256:
        allowed = f"{sha256}, as {PROVENANCE_FILE} has it; export the policy again"
        raise InputError(path, value=f"other contents, {len(content)} bytes with SHA-256 {found}", allowed=allowed)
    return content


def _provenance(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(_content(path).decode())
    except ValueError as error:  # JSON's, or UTF-8's
        raise InputError(path, value=f"unreadable contents ({error})", allowed=_AS_WRITTEN) from error
    _check_version(path, document)
    files = document.get("files")
    if not isinstance(files, dict) or set(files) != set(HASHED):
        given = sorted(files) if isinstance(files, dict) else files
        raise InputError(path, value=f"files: {given}", allowed=f"SHA-256 of {', '.join(HASHED)}")
    if document.get("sha256") != (found := provenance_hash(document)):
        allowed = f"{document.get('sha256')}, its entry sha256; export the policy again"
        raise InputError(path, value=f"other contents, with SHA-256 {found}", allowed=allowed)
    return document


def _contract(path: Path, content: bytes) -> tuple[PolicySpec, SafetyLimits, dict[str, Any]]:
    try:
        document = yaml.safe_load(content.decode())
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(path, value=f"unreadable contents ({error})", allowed=_AS_WRITTEN) from error
    _check_version(path, document)
    document = upgraded(document)
    try:
        spec = PolicySpec.from_document(document.get("spec"))
        limits = SafetyLimits.from_document(document.get("safety"))
    except ParameterError as error:
        raise InputError(path, value=error, allowed="a contract that `pinwm export` wrote") from error
    if spec.observes != "rgb":
        raise InputError(path, value=f"spec.observes: {spec.observes}", allowed="rgb; other policies have no bundle")
    if (differs := difference(document, make_contract(spec, limits))) is not None:
        name, found, expected = differs
        raise InputError(path, value=f"{name}: {found}", allowed=f"{expected}, which follows from spec and safety")
    return spec, limits, document


def _check_version(path: Path, document: Any) -> None:
    if not isinstance(document, dict):
        raise InputError(path, value=f"a {type(document).__name__}", allowed=_AS_WRITTEN)
    if (version := document.get("schema_version")) not in VERSIONS or isinstance(version, bool):
        allowed = f"schema_version {' or '.join(map(str, VERSIONS))}"
        raise InputError(path, value=f"schema_version {version}", allowed=allowed)
