"""Compiled loops of the software renderer."""

from numba.core import caching

from rig.face.render.software import compiled


def test_loops_run_where_no_folder_can_be_written(monkeypatch):
    """A read-only installation and home: the machine code is not kept."""
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    double = compiled(lambda x: 2 * x)
    assert double(3.0) == 6.0
