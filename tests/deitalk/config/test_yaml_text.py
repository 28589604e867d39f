"""Limits of YAML: plain values of bounded size and nesting."""

import time

import pytest
import yaml

from deitalk.config import yaml_text
from deitalk.config.yaml_text import load_yaml, read_yaml
from deitalk.emotions import parse_emotion
from deitalk.errors import ConfigError, EmotionError
from rig import limits
from tests.each import each


def refused(text):
    start = time.process_time()
    with pytest.raises(ConfigError) as caught:
        load_yaml(text, "it.yaml")
    message = str(caught.value)
    assert time.process_time() - start < 1
    assert "\n" not in message and len(message) <= limits.MESSAGE_CHARACTERS
    assert message.startswith("it.yaml")
    return message


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


def test_anchor_is_read_and_alias_is_refused():
    assert load_yaml("a: &x [1]", "a") == {"a": [1]}
    assert "alias '*x' is not read; repeat the value" in refused("a: &x [1]\nb: *x")


@each("levels", [2, 6, 9, 20])
def test_alias_bomb_is_refused_before_it_is_built(levels):
    assert "alias '*a0' is not read" in refused(bomb(levels))


def test_values_at_the_limit_are_read_and_above_are_not():
    text = "[" + "0," * (limits.YAML_VALUES - 2) + "]"
    assert len(load_yaml(text, "a")) == limits.YAML_VALUES - 2
    assert "more than 50000 values" in refused(text[:-1] + "0,0]")


@each("style", ["flow", "block"])
def test_nesting_at_the_limit_is_read_and_above_is_not(style):
    def nested(depth):
        if style == "flow":
            return "[" * depth + "]" * depth
        return "- " * depth + "x"

    assert load_yaml(nested(limits.NESTING), "a")
    assert "deeper than 32 levels" in refused(nested(limits.NESTING + 1))


@each("text", ["[" * 100_000, "- " * 50_000, "{a: " * 20_000, "? " * 20_000])
def test_deep_nesting_is_refused_quickly(text):
    assert "deeper than 32 levels" in refused(text)


@each("loader", ["CSafeLoader", "SafeLoader"])
def test_deep_nesting_is_told_alike_by_every_parser(monkeypatch, loader):
    if not hasattr(yaml, loader):
        pytest.skip("PyYAML was built without libyaml")
    monkeypatch.setattr(yaml_text, "_Loader", getattr(yaml, loader))
    for text in ("[" * 2000 + "]" * 2000, "- " * 2000 + "x", "{a: " * 2000 + "1" + "}" * 2000):
        message = "it.yaml: cannot be read as YAML (nested deeper than 32 levels)"
        assert refused(text) == message


def test_scalar_at_the_limit_is_read_and_above_is_not():
    assert load_yaml("x" * limits.SCALAR_CHARACTERS, "a") == "x" * 4096
    assert "value of 4097 characters" in refused("x" * (limits.SCALAR_CHARACTERS + 1))
    assert "value of 199999 characters" in refused("a: " + ":".join(["1"] * 100_000)[:200_000])


def test_text_beyond_the_limit_is_refused():
    assert "262145 characters of YAML; at most 262144" in refused("#" * (limits.YAML_BYTES + 1))


@each(
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


def test_emotion_file_rejects_an_alias_bomb(tmp_path):
    (tmp_path / "e.yaml").write_text(bomb(9))
    with pytest.raises(EmotionError, match=r"alias .* is not read"):
        parse_emotion(tmp_path / "e.yaml")


def test_file_is_read_in_utf_16(tmp_path):
    (tmp_path / "a.yaml").write_bytes("name: Zoë".encode("utf-16"))
    assert read_yaml(tmp_path / "a.yaml") == {"name": "Zoë"}
