"""Networks of curves by name, folder or as they are, in torch or in ONNX Runtime.

`deitalk.models.checkpoint` reads model folders for torch and `deitalk.models.onnx` for ONNX
Runtime; both are imported only where they are needed, so that one does not wait for the other.
"""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

from deitalk.errors import CheckpointError, DeitalkError
from deitalk.models.folder import model_folder
from deitalk.models.protocol import CausalNetwork, CurveNetwork, check_product
from rig.errors import quoted

if TYPE_CHECKING:
    from deitalk.models.checkpoint import Model

Backend: TypeAlias = Literal["auto", "torch", "onnx"]
BACKENDS: tuple[Backend, ...] = ("auto", "torch", "onnx")


def chosen_backend(
    model: "str | Path | CurveNetwork | Model", backend: str = "auto", device: str = "cpu"
) -> Literal["torch", "onnx"]:
    """Return what evaluates a model: of ``auto``, ONNX Runtime on a processor if it has a graph.

    Raises
    ------
    DeitalkError
        If the backend is unknown.
    CheckpointError
        If there is no such model.
    """
    if backend not in BACKENDS:
        raise DeitalkError(f"backend {quoted(backend)} is unknown; use {', '.join(BACKENDS)}")
    if backend != "auto":
        return "torch" if backend == "torch" else "onnx"
    if device != "cpu" or not isinstance(model, str | Path) or find_spec("onnxruntime") is None:
        return "torch"
    from deitalk.models.onnx.graphs import ready_graph

    return "onnx" if ready_graph(model_folder(model)) else "torch"


def load_network(
    model: "str | Path | CurveNetwork | Model",
    *,
    backend: str = "auto",
    device: str = "cpu",
    threads: int = 1,
    once: bool = False,
) -> CurveNetwork:
    """Return a curve network, loaded if a name or a folder is given.

    Parameters
    ----------
    model : str, Path or CurveNetwork
        As for `deitalk.models.checkpoint.load_model`; or a loaded network, which stays as it is.
    backend : str
        ``torch``; ``onnx``: ONNX Runtime, for which the graph of a model that has none is written
        into the cache once; ``auto``: see `chosen_backend`.
    device : str
        As for `load_model`; ONNX Runtime has ``cpu`` only.
    threads : int
        Processor threads of ONNX Runtime; those of torch are set for the process.
    once : bool
        Whether it reads one recording: ONNX Runtime then starts faster, and runs 5 ms longer.

    Raises
    ------
    CheckpointError
        If it cannot be loaded or is no curve model.
    DeitalkError
        If the backend is unknown, not installed, or lacks the device.
    """
    chosen = chosen_backend(model, backend, device)
    if not isinstance(model, str | Path):
        check_product(model, "curves")
        return cast("CurveNetwork", model.eval())
    if chosen == "onnx":
        from deitalk.models.onnx import load_onnx

        return load_onnx(model, device=device, threads=threads, once=once)
    from deitalk.models.checkpoint import require_model
    from deitalk.models.curve_model import DEITalk

    return require_model(model, DEITalk, device=device)


def load_causal(
    model: str | Path | CurveNetwork | CausalNetwork, *, backend: str = "auto", lasts: bool = False
) -> CausalNetwork:
    """Return a causal network; arguments and errors as for `load_network`.

    One that `lasts` reads for minutes: see `deitalk.models.causal_model.TorchNetwork`.

    Raises
    ------
    CheckpointError
        Also if the model needs the whole clip.
    """
    if hasattr(model, "first_state"):
        return cast("CausalNetwork", model)
    network = load_network(model, backend=backend)
    if not network.is_causal:
        raise CheckpointError(
            f"model {quoted(str(model))} needs the whole clip; use the model live, or one trained "
            "from configs/live.yaml"
        )
    if hasattr(network, "first_state"):
        return cast("CausalNetwork", network)
    from deitalk.models.causal_model import TorchNetwork

    return TorchNetwork(cast(Any, network), lasts=lasts)
