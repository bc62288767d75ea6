# SPDX-License-Identifier: MIT
"""A policy bundle: a folder that holds all that a controller needs, and that onnxruntime runs, after a check by onnx.

    policy.onnx       the network: images and the pusher's position in; translation in metres and estimate out
    contract.yaml     inputs, outputs and limits (`contract.py`)
    golden.npz        samples with the policy's answers to them when it was exported (`golden.py`)
    provenance.json   the policy's origin; SHA-256 of the other three, and of itself without that

Neither torch nor Stable-Baselines3 nor Drake is imported here.
"""

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.errors import InputError, ParameterError, require
from pinwm_drake.files import appearing
from pinwm_drake.learning.contract import ESTIMATE, SCHEMA_VERSION, ArmCheck, difference, make_contract
from pinwm_drake.learning.golden import ESTIMATE_TOLERANCE, TOLERANCE, Golden, deviation, estimate_deviation
from pinwm_drake.learning.runtime import Network
from pinwm_drake.learning.safety import SafetyLimits
from pinwm_drake.learning.spec import PolicySpec, seen_parts
from pinwm_drake.models import policy_path
from pinwm_drake.reading.contents import read_bytes
from pinwm_drake.reading.network import within
from pinwm_drake.reading.trees import check_finite, no_infinite, parse_json, parse_yaml

ONNX_FILE, CONTRACT_FILE, GOLDEN_FILE, PROVENANCE_FILE = "policy.onnx", "contract.yaml", "golden.npz", "provenance.json"
HASHED = (ONNX_FILE, CONTRACT_FILE, GOLDEN_FILE)
_MOST_BYTES = 2**28  # of a file
_LONGEST_CHECK = 8.0  # s, for loading and all golden samples
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
        mask_pixels: Least and largest number of the object's pixels in one of the golden images; see `Golden`.
        goal: (goal_size,) goal that it acts towards, where the network is told one; None until `toward` gives it.
    """

    spec: PolicySpec
    limits: SafetyLimits
    contract: dict[str, Any]
    provenance: dict[str, Any]
    sha256: str
    network: Network
    mask_pixels: tuple[int, int]
    goal: tuple[float, ...] | None = None

    def toward(self, goal: Sequence[float]) -> "Bundle":
        """Return the bundle for another goal of its task, such as x [m], y [m], yaw [rad] of a push, world.

        Args:
            goal: (task.goal_size,) the goal.

        Raises:
            ParameterError: The policy is not told its goal, or the goal is not one of that many finite numbers.
        """
        values, size = tuple(float(value) for value in goal), self.network.goal_size
        if not size or len(values) != size or not all(math.isfinite(value) for value in values):
            allowed = f"{size} finite numbers" if size else "none: the policy has the goal that it was trained for"
            raise ParameterError(f"goal: got {list(values)}; allowed: {allowed}")
        task = self.spec.task.with_goal(np.array(values))
        return replace(self, spec=replace(self.spec, task=task), goal=values)

    def act(self, image: np.ndarray, p_WP: np.ndarray) -> np.ndarray:
        """Return the pusher's translation d_W (n,) m along the task's axes over the horizon, at most `max_translation`.

        NaN where the position is NaN; a position outside the box counts as at its wall.

        Args:
            image: (height, width, 3 k) uint8, RGB: the last k images, the oldest first.
            p_WP: (spec.pusher_size,) m, world: position of the pusher along the task's axes when the last image was
                taken; with a history what `PolicySpec.pusher_seen` lists after it.

        Raises:
            StateError: A shape, or the image's type, is another, or no goal was given where one has to be.
        """
        return self.step(image, p_WP)[0]

    def step(self, image: np.ndarray, p_WP: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the translation d_W as by `act`, and the policy's estimate (state_size,) of the task's state.

        The contract names the components of the estimate, and their units. It is None where the policy was
        not taught the state.

        Args:
            image: As for `act`.
            p_WP: As for `act`.

        Raises:
            StateError: A shape, or the image's type, is another.
        """
        d_W, estimate = self.network.run(image, p_WP, self._goal)
        return d_W.astype(float), None if estimate is None else estimate.astype(float)

    def predict(
        self, observation: Any, state: None = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[np.ndarray, None]:
        """Actions (n,) or (B, n) float32 in [-1, 1]^n and no longer than 1; with the signature of `Policy.predict`.

        Args:
            observation: Observation of one world or of B, as the environment gives it: a dict of which `image`,
                `pusher`, across the box, and `goal`, where the policy is told one and has none, are used.
            state: Not used.
            episode_start: Not used.
            deterministic: Not used: it always is.

        Raises:
            ParameterError: There is no image or pusher in the observation.
            StateError: Their shapes, or the image's type, are others.
        """
        image, pusher = seen_parts(observation, "image", "pusher")
        p_WP = self.spec.pusher_metres(pusher)
        told = self.network.goal_size and self.goal is None
        goal = seen_parts(observation, "goal")[0] if told else np.zeros((len(np.atleast_2d(p_WP)), 0))
        rows = zip(image.reshape(-1, *image.shape[-3:]), np.atleast_2d(p_WP), np.atleast_2d(goal), strict=True)
        answers = [self.network.run(*one[:2], one[2] if told else self._goal)[0] for one in rows]
        actions = np.array(answers).reshape(-1, self.spec.action_size) / self.spec.max_translation
        return (actions[0] if image.ndim == 3 else actions).astype(np.float32), None

    @property
    def _goal(self) -> np.ndarray | None:
        return None if self.goal is None else np.array(self.goal, np.float32)


def is_bundle(folder: Path) -> bool:
    """Flag: a folder is, or was meant to be, a bundle and not the policy that `pinwm train` writes."""
    return any((folder / name).exists() for name in (ONNX_FILE, CONTRACT_FILE, PROVENANCE_FILE))


def read_bundle(bundle: str | Path) -> Bundle:
    """Read a bundle and check it: files, SHA-256, contract, network, and its answers to the golden samples.

    Args:
        bundle: Folder of the bundle; a text may also be the name of one that ships, such as "push_t".

    Raises:
        InputError: There is none, a file is missing, too many, changed or cut off, of another version, or the files
            do not fit each other.
    """
    folder = policy_path(bundle) if isinstance(bundle, str) else bundle
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
    golden = Golden.from_bytes(files[GOLDEN_FILE], folder / GOLDEN_FILE, contract)
    mask = make_contract(spec, limits, golden.mask_pixels())["mask"]
    if (differs := difference(contract.get("mask"), mask, "mask")) is not None:
        name, found, wanted = differs
        allowed = f"{wanted}, which follows from {GOLDEN_FILE}"
        raise InputError(folder / CONTRACT_FILE, value=f"{name}: {found}", allowed=allowed)

    def checked() -> Network:
        network = Network(files[ONNX_FILE], folder / ONNX_FILE, contract)
        check_golden(folder / GOLDEN_FILE, network, golden)
        return network

    network = within(_LONGEST_CHECK, checked, folder / ONNX_FILE)
    return Bundle(spec, limits, contract, provenance, provenance["sha256"], network, golden.mask_pixels())


def write_bundle(folder: Path, files: Mapping[str, bytes], provenance: Mapping[str, Any]) -> Bundle:
    """Write a bundle, which appears whole or not at all, and read it back.

    Args:
        folder: Folder of the bundle, new or empty.
        files: Contents of the files of `HASHED`, by name.
        provenance: The provenance without SHA-256, as JSON takes it; what it does not take becomes a text.

    Raises:
        InputError: The folder holds something or cannot be written to, or the files do not fit each other.
    """
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    # As it will be read; numbers that are not finite become texts too.
    given = json.dumps({**provenance, "files": hashes, "sha256": None}, default=str)
    document = parse_json(given, folder / PROVENANCE_FILE, not_finite=str)
    document["sha256"] = provenance_hash(document)
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    with appearing(folder) as temporary:
        for name, content in {**files, PROVENANCE_FILE: text.encode()}.items():
            (temporary / name).write_bytes(content)
        return read_bundle(temporary)


def check_golden(path: Path, network: Network, golden: Golden) -> float:
    """Largest distance of the network's translations from the golden ones, m.

    Raises:
        InputError: A translation or an estimate is beyond its tolerance.
    """
    answers = []
    for row, (image, p_WP, expected) in enumerate(zip(golden.images, golden.p_WP, golden.d_W, strict=True), 1):
        answer, estimate = network.run(image, p_WP, None if golden.goal is None else golden.goal[row - 1])
        if not (gap := deviation(answer, expected)) <= TOLERANCE:
            value = f"{expected.tolist()} m, where {ONNX_FILE} answers {answer.tolist()} m, {gap:.2g} m off"
            raise InputError(path, row=row, value=value, allowed=f"{TOLERANCE:g} m between the two")
        if golden.estimate is not None:
            assert estimate is not None
            told = golden.estimate[row - 1]
            if not (gap := estimate_deviation(estimate, told)) <= ESTIMATE_TOLERANCE:
                value = f"{ESTIMATE} {told.tolist()}, where {ONNX_FILE} answers {estimate.tolist()}, {gap:.2g} off"
                raise InputError(path, row=row, value=value, allowed=f"{ESTIMATE_TOLERANCE:g} between the two")
        answers.append(answer)
    return deviation(np.array(answers), golden.d_W)


def provenance_hash(document: Mapping[str, Any]) -> str:
    """SHA-256 of a provenance without its entry `sha256`; the layout of its file does not count."""
    rest = {name: value for name, value in document.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def _content(path: Path) -> bytes:
    if not os.path.lexists(path):
        raise InputError(path, value="no such file", allowed=_AS_WRITTEN)
    return read_bytes(path, _MOST_BYTES)


def _hashed(path: Path, sha256: str) -> bytes:
    """Return the content of a file; raises InputError where its SHA-256 is another one."""
    content = _content(path)
    found = hashlib.sha256(content).hexdigest()
    if found != sha256:
        allowed = f"{str(sha256)[:12]}, as {PROVENANCE_FILE} has it; export the policy again"
        raise InputError(path, value=f"other contents, {len(content)} bytes with SHA-256 {found[:12]}", allowed=allowed)
    return content


def _document(path: Path, document: Any) -> dict[str, Any]:
    """Return a document of the present version."""
    if not isinstance(document, dict):
        raise InputError(path, value=f"a {type(document).__name__}", allowed=_AS_WRITTEN)
    version = document.get("schema_version")
    if version != SCHEMA_VERSION or isinstance(version, bool):
        anew = "; export the bundle anew with the release 0.1" if version == 1 and version is not True else ""
        raise InputError(path, value=f"schema_version {version}", allowed=f"schema_version {SCHEMA_VERSION}{anew}")
    return document


def _provenance(path: Path) -> dict[str, Any]:
    document = _document(path, parse_json(_content(path), path, not_finite=no_infinite(path)))
    files = document.get("files")
    if not isinstance(files, dict) or set(files) != set(HASHED):
        given = sorted(files) if isinstance(files, dict) else files
        raise InputError(path, value=f"files: {given}", allowed=f"SHA-256 of {', '.join(HASHED)}")
    if document.get("sha256") != (found := provenance_hash(document)):
        allowed = f"{str(document.get('sha256'))[:12]}, its entry sha256; export the policy again"
        raise InputError(path, value=f"other contents, with SHA-256 {found[:12]}", allowed=allowed)
    return document


def _contract(path: Path, content: bytes) -> tuple[PolicySpec, SafetyLimits, dict[str, Any]]:
    document = _document(path, parse_yaml(content, path))
    try:
        spec = PolicySpec.from_document(document.get("spec"))
        limits = SafetyLimits.from_document(document.get("safety"))
        told = document.get("arms", [])
        require("arms", told, isinstance(told, list), "a list of checks of arms")
        arms = [ArmCheck.from_document(one) for one in told]
    except ParameterError as error:
        raise InputError(path, value=error, allowed="a contract that `pinwm export` wrote") from error
    if spec.observes != "rgb":
        raise InputError(path, value=f"spec.observes: {spec.observes}", allowed="rgb; other policies have no bundle")
    # The mask follows from the golden samples, which follow from the specification: it is compared after them.
    expected = make_contract(spec, limits, (), estimate=ESTIMATE in str(document.get("outputs")), arms=arms)
    shown, expected = ({name: one for name, one in each.items() if name != "mask"} for each in (document, expected))
    if (differs := difference(shown, expected)) is not None:
        name, found, wanted = differs
        raise InputError(path, value=f"{name}: {found}", allowed=f"{wanted}, which follows from spec and safety")
    check_finite(document, path)  # words may be other ones
    return spec, limits, document
