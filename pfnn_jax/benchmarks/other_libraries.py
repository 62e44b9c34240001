"""One frame of one character in PyTorch and in onnxruntime, from our parameters: what a user would pick instead.

Neither is a dependency of the package; what is not installed is left out.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.inference.lookup import Lookup
from pfnn_jax.inference.predictor import Predictor
from pfnn_jax.interop.export.batch import batch_function
from pfnn_jax.interop.export.onnx import write_onnx
from pfnn_jax.models.layers.dense import DenseLayer
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.layers.full import BlendedLayer

Frame = Callable[..., Any]
"""(x [Dx], phase [] or [G]) -> y [Dy], NumPy arrays in layout units."""

TOLERANCE = 2e-5
"""Largest difference between another library and ours, relative to the largest output: float32 sums of some thousand
products in another order."""

PACKAGES = {"PyTorch": ("torch",), "onnxruntime": ("onnxruntime", "jax2onnx")}
"""Packages that a library's frames need."""


def is_installed(library: str) -> bool:
    """Returns whether all packages of a library can be imported."""
    return all(find_spec(package) is not None for package in PACKAGES[library])


def check_equal(name: str, frame: Frame, ours: Frame, x: np.ndarray, phases: list[Any]) -> None:
    """Checks that another library computes the same frames as ours.

    Raises:
        ValueError: naming the library and its error, if it does not.
    """
    found, expected = (np.stack([np.asarray(each(x, phase)) for phase in phases]) for each in (frame, ours))
    error = np.abs(found - expected).max() / np.abs(expected).max()
    if not error <= TOLERANCE:
        raise ValueError(f"{name} must compute the same as JAX to {TOLERANCE:g}, got a relative error of {error:.1e}.")


def torch_frame(predictor: Predictor, *, blended: bool) -> Frame:
    """Returns a network's frame in PyTorch, for a phase-functioned network without a style or an LPN with FiLM.

    Args:
        predictor: the network.
        blended: whether to blend the experts into one network, and else to scale the input by every coefficient.
    """
    torch = _torch()

    layers = [
        _tensors(layer.weights, layer.biases) for layer in predictor.network.layers if isinstance(layer, BlendedLayer)
    ]
    sizes = [weights.shape[1:] for weights, _ in layers]
    flat = [weights.reshape(len(weights), -1) if blended else weights.flatten(0, 1) for weights, _ in layers]
    input_mean, input_std, output_mean, output_std = _tensors(
        predictor.input_mean, predictor.input_std, predictor.output_mean, predictor.output_std
    )
    coefficients, modulate = _torch_coefficients(predictor), _torch_modulation(predictor)

    def layer(index: int, c: Any, h: Any) -> Any:
        if blended:
            return h @ (c @ flat[index]).reshape(sizes[index]) + c @ layers[index][1]
        return (c[:, None] * h).reshape(-1) @ flat[index] + c @ layers[index][1]

    def frame(x: np.ndarray, gating_input: Any) -> np.ndarray:
        with torch.inference_mode():
            c, h = coefficients(gating_input), (torch.from_numpy(x) - input_mean) / input_std
            for index in range(2):
                h = torch.nn.functional.elu(modulate(index, layer(index, c, h)))
            return (layer(2, c, h) * output_std + output_mean).numpy()

    return frame


def torch_lookup(lookup: Lookup) -> Frame:
    """Returns the frame of a lookup table in PyTorch: one linear layer after another, of the entry of the phase."""
    torch = _torch()

    entries = [
        [
            _tensors(np.array(layer.weights).T, layer.biases)
            for layer in entry.network.layers
            if isinstance(layer, DenseLayer)
        ]
        for entry in lookup.slices
    ]
    p = lookup.predictor
    input_mean, input_std, output_mean, output_std = _tensors(p.input_mean, p.input_std, p.output_mean, p.output_std)
    linear, elu = torch.nn.functional.linear, torch.nn.functional.elu

    def frame(x: np.ndarray, phase: Any) -> np.ndarray:
        first, second, third = entries[math.floor(float(phase) * len(entries) / (2 * math.pi) + 0.5) % len(entries)]
        with torch.inference_mode():
            h = elu(linear((torch.from_numpy(x) - input_mean) / input_std, *first))
            return (linear(elu(linear(h, *second)), *third) * output_std + output_mean).numpy()

    return frame


def onnx_frame(predictor: Predictor, phase: Any) -> Frame:
    """Returns a network's frame as exported to ONNX, in onnxruntime on the processor; the phase is an example."""
    import onnxruntime

    x = np.zeros((1, len(predictor.input_mean)), np.float32)
    rows = {"x": x, "phase": np.asarray(phase, np.float32)[None]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "network.onnx"
        write_onnx(path, batch_function(predictor), rows)
        session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])

    def frame(x: np.ndarray, phase: Any) -> np.ndarray:
        return np.asarray(session.run(["y"], {"x": x[None], "phase": np.asarray(phase, np.float32)[None]})[0])[0]

    return frame


def _torch() -> Any:
    return import_module("torch")


def _tensors(*arrays: Any) -> tuple[Any, ...]:
    torch = _torch()

    return tuple(torch.from_numpy(np.array(array)) for array in arrays)


def other_frames(predictor: Predictor, phase: Any) -> dict[str, Frame]:
    """Returns a network's frames by the installed libraries, by name; the phase is an example."""
    frames: dict[str, Frame] = {}
    if is_installed("PyTorch"):
        frames["PyTorch, experts blended"] = torch_frame(predictor, blended=True)
        frames["PyTorch, products over all experts"] = torch_frame(predictor, blended=False)
    if is_installed("onnxruntime"):
        frames["onnxruntime"] = onnx_frame(predictor, phase)
    return frames


def _torch_coefficients(predictor: Predictor) -> Callable[[Any], Any]:
    """Returns the function from a phase, or a gating input in layout units, to the blending coefficients."""
    torch = _torch()

    gating = predictor.network.gating
    if gating is None:
        points = predictor.network.num_control_points
        return lambda phase: torch.from_numpy(_spline(float(phase), points))
    mean, std = _tensors(predictor.gating_mean, predictor.gating_std)
    layers = [_tensors(layer.weights, layer.biases) for layer in gating.layers]

    def coefficients(gating_input: np.ndarray) -> Any:
        h = (torch.from_numpy(gating_input) - mean) / std
        for weights, biases in layers[:2]:
            h = torch.nn.functional.elu(h @ weights + biases)
        return torch.softmax(h @ layers[2][0] + layers[2][1], dim=0)

    return coefficients


def _spline(phase: float, points: int) -> np.ndarray:
    """Returns the coefficients [K] of the cyclic Catmull-Rom spline, without the cost of an array library."""
    turns = phase * points / (2 * math.pi)
    first, t = math.floor(turns), turns - math.floor(turns)
    values = (
        ((2.0 - t) * t - 1.0) * t / 2,
        ((3.0 * t - 5.0) * t * t + 2.0) / 2,
        ((4.0 - 3.0 * t) * t + 1.0) * t / 2,
        (t - 1.0) * t * t / 2,
    )
    c = np.zeros(points, np.float32)
    for offset, value in zip(range(-1, 3), values, strict=True):
        c[(first + offset) % points] += value
    return c


def _torch_modulation(predictor: Predictor) -> Callable[[int, Any], Any]:
    """Returns what stands between a hidden layer and its ELU: FiLM, or nothing."""
    torch = _torch()

    film = predictor.style
    if film is None:
        return lambda index, f: f
    assert isinstance(film, FiLMStyle)
    scale, shift = _tensors(film.scale, film.shift)
    return lambda index, f: torch.nn.functional.layer_norm(f, f.shape, scale[index], shift[index], 1e-8)
