"""Networks of curves by name, folder, file or as they are, in torch or in ONNX Runtime.

`deitalk.models.checkpoint` reads model folders and `deitalk.models.onnx` ONNX files; both are
imported only where they are needed, so that one backend does not wait for the other.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

from deitalk.errors import CheckpointError, DeitalkError
from deitalk.models.protocol import CausalNetwork, CurveNetwork, check_product
from rig.errors import quoted

if TYPE_CHECKING:
    from deitalk.models.checkpoint import Model

Backend: TypeAlias = Literal["torch", "onnx"]
BACKENDS: tuple[Backend, ...] = ("torch", "onnx")


def load_network(
    model: "str | Path | CurveNetwork | Model",
    *,
    backend: str = "torch",
    device: str = "cpu",
    threads: int = 1,
) -> CurveNetwork:
    """Return a curve network, loaded if a name, a folder or an ONNX file is given.

    Parameters
    ----------
    model : str, Path or CurveNetwork
        As for `deitalk.models.checkpoint.load_model`; an ``.onnx`` file of
        ``deitalk model export --onnx``; or a loaded network, which stays as it is.
    backend : str
        ``torch``, or ``onnx``: ONNX Runtime, for which a model is exported once into the cache.
    device : str
        As for `load_model`; ONNX Runtime has ``cpu`` only.
    threads : int
        Processor threads of ONNX Runtime; those of torch are set for the process.

    Raises
    ------
    CheckpointError
        If it cannot be loaded or is no curve model.
    DeitalkError
        If the backend is unknown, not installed, or lacks the device.
    """
    if backend not in BACKENDS:
        raise DeitalkError(f"backend {quoted(backend)} is unknown; use torch or onnx")
    if not isinstance(model, str | Path):
        check_product(model, "curves")
        return cast("CurveNetwork", model.eval())
    if is_onnx(model, backend):
        from deitalk.models.onnx import load_onnx

        return load_onnx(model, device=device, threads=threads)
    from deitalk.models.checkpoint import require_model
    from deitalk.models.curve_model import DEITalk

    return require_model(model, DEITalk, device=device)


def is_onnx(model: str | Path, backend: str) -> bool:
    """Whether a model is evaluated by ONNX Runtime."""
    return backend == "onnx" or str(model).endswith(".onnx")


def load_causal(
    model: str | Path | CurveNetwork | CausalNetwork, *, backend: str = "torch"
) -> CausalNetwork:
    """Return a causal network; arguments and errors as for `load_network`.

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
    from deitalk.models.curve_model import TorchNetwork

    return TorchNetwork(cast(Any, network))
