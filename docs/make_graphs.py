"""Write the graphs of the embedded models again: ``python docs/make_graphs.py``.

After a change of a module that they are traced from, which a test of
tests/deitalk/models/test_onnx.py tells.
"""

from deitalk.models.checkpoint import require_model
from deitalk.models.curve_model import DEITalk
from deitalk.models.folder import GRAPH, model_folder
from deitalk.models.onnx.engine_graph import write_graph

for name in ("default", "live", "small"):
    folder = model_folder(name)
    write_graph(require_model(name, DEITalk), folder, folder / GRAPH)
