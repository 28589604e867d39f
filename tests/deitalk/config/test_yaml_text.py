"""Limits of YAML: plain values of bounded size and nesting."""

import time

import pytest
import yaml

from deitalk.config import yaml_files
from deitalk.config.yaml_files import load_yaml
from deitalk.errors import ConfigError
from rig import limits
from tests.errors import one_line


def refused(text):
    start = time.process_time()
    with one_line(ConfigError) as caught:
        load_yaml(text, "it.yaml")
    assert time.process_time() - start < 1
    assert str(caught.value).startswith("it.yaml")
    return str(caught.value)


def bomb(levels):
    """A text of a few hundred bytes that expands to 9 ** levels values."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    for i in range(1, levels):
        lines.append(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]")
    return "\n".join(lines)


def test_plain_values_are_read():
    tree = {"a": [1, 2.5, "x", None, True], "b": {"c": []}}
    assert load_yaml(yaml.safe_dump(tree), "a") == tree
    assert load_yaml("", "a") is None


@pytest.mark.parametrize("text", ["a: 1\nb: 2\na: 3", "b:\n  - {a: 1, c: 2, 'a': 1}", "a:\na:"])
def test_a_key_that_is_given_twice_is_told(text):
    assert "key 'a' is given twice" in refused(text)
    assert load_yaml(text.replace("a", "x", 1), "it")


@pytest.mark.parametrize("levels", [2, 6, 9, 20])
def test_alias_bomb_is_refused_before_it_is_built(levels):
    assert "alias '*a0' is not read" in refused(bomb(levels))


def test_values_at_the_limit_are_read_and_above_are_not():
    text = "[" + "0," * (limits.YAML_VALUES - 2) + "]"
    assert len(load_yaml(text, "a")) == limits.YAML_VALUES - 2
    assert "more than 50000 values" in refused(text[:-1] + "0,0]")


@pytest.mark.parametrize("style", ["flow", "block"])
def test_nesting_at_the_limit_is_read_and_above_is_not(style):
    def nested(depth):
        if style == "flow":
            return "[" * depth + "]" * depth
        return "- " * depth + "x"

    assert load_yaml(nested(limits.NESTING), "a")
    assert "deeper than 32 levels" in refused(nested(limits.NESTING + 1))


@pytest.mark.parametrize("loader", ["CSafeLoader", "SafeLoader"])
def test_deep_nesting_is_told_alike_by_every_parser(monkeypatch, loader):
    if not hasattr(yaml, loader):
        pytest.skip("PyYAML was built without libyaml")
    monkeypatch.setattr(yaml_files, "_Loader", getattr(yaml, loader))
    for text in ("[" * 2000 + "]" * 2000, "- " * 2000 + "x", "{a: " * 2000 + "1" + "}" * 2000):
        message = "it.yaml: cannot be read as YAML (nested deeper than 32 levels)"
        assert refused(text) == message


def test_text_beyond_the_limit_is_refused():
    assert "262145 characters of YAML; at most 262144" in refused("#" * (limits.YAML_BYTES + 1))


@pytest.mark.parametrize(
    "text",
    ["!!int x", "!!int ''", "!!float ''", "!!bool maybe", "!!timestamp x", "2024-99-99", "&a [*a]",
     "*a", "!!python/object/apply:os.getcwd []", "a: b: c", "\x00", "[1", "? [1, 2]\n: 3",
     "<<: 1", "--- 1\n--- 2", "!!binary x", "!!int " + "9" * 4000, "!!int " + "1:" * 2000 + "1"],
)  # fmt: skip
def test_yaml_rejects(text):
    if text.startswith("!!int 9"):
        assert load_yaml(text, "a") == int("9" * 4000)  # Python's own limit is 4300 digits
        return
    if text.startswith("!!int 1:"):
        assert isinstance(load_yaml(text, "a"), int)
        return
    assert "cannot be read as YAML" in refused(text)
