"""JSON and YAML of others as plain values: against PyYAML's own reader, and what is refused."""

import json

import numpy as np
import pytest
import yaml

from pinograsp.plain import YamlValues, plain_json, plain_yaml


def random_values(rng, depth=0):
    kind = rng.integers(7 if depth < 4 else 5)
    if kind < 5:
        texts = ["", "on", "1", "a: b", "'", "- x", "é", "null", "#", "two\nlines"]
        leaves = [int(rng.integers(-9, 9)), float(rng.normal()), True, None, texts[rng.integers(len(texts))]]
        return leaves[kind]
    inner = [random_values(rng, depth + 1) for _ in range(rng.integers(4))]
    return inner if kind == 5 else {f"k{i} ": one for i, one in enumerate(inner)}


@pytest.mark.parametrize("flow", [None, True, False])
def test_yaml_is_what_its_writer_meant(flow):
    rng = np.random.default_rng(5)
    for _ in range(40):
        values = [random_values(rng) for _ in range(3)]
        text = yaml.safe_dump_all(values, default_flow_style=flow)
        assert plain_yaml(text.encode(), 20, 10**6) == values
        assert plain_json(json.dumps(values).encode(), 20) == values


def test_values_that_are_shared_are_read_once():
    shared = [0.0, 0.5]
    text = yaml.safe_dump({"a": shared, "b": [shared, shared]})
    assert "*" in text
    assert plain_yaml(text.encode(), 5, 100) == [{"a": shared, "b": [shared, shared]}]


def test_numbers_without_a_point_before_the_exponent():
    """Texts to YAML 1.1, and what ROS 1 prints."""
    assert plain_yaml(b"[1e-05, -2E3, 010, 1., '1e5']", 5, 100) == [[1e-5, -2000.0, 10, 1.0, "1e5"]]


def test_texts_are_those_of_yaml_1_2():
    text = b"[on, no, yes, 1:30, 2026-01-01, true, FALSE, null, ~, .inf, 0x1F]"
    assert plain_yaml(text, 5, 100) == [
        ["on", "no", "yes", "1:30", "2026-01-01", True, False, None, None, float("inf"), 31]
    ]
    merged = b"a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}"
    assert plain_yaml(merged, 5, 100) == [{"a": {"x": 1, "y": 2}, "b": {"x": 1, "y": 3}}]


def test_a_document_that_breaks_off_is_there_up_to_there():
    values = YamlValues("a: 1\nb: {c: 2}\nd: [1, {e: 3}, [", 5, 100)
    with pytest.raises(yaml.YAMLError):
        values.run()
    assert values.documents == [{"a": 1, "b": {"c": 2}, "d": [1, {"e": 3}, []]}]


LAUGHS = b"a: &a [0,0,0,0,0,0,0,0,0]\n" + b"".join(
    b"%c: &%c [%s]\n" % (98 + i, 98 + i, b",".join([b"*%c" % (97 + i)] * 9)) for i in range(9)
)


@pytest.mark.parametrize(
    "content",
    [
        *(LAUGHS, b"&a [*a]", b"[*b]", b"[" * 100_000, b"a: " * 1000, b"{a: 1, a: 2}", b"!!python/name:os.system x"),
        *(b"!x 1", b"9" * 401, b"\xff", b"a: [", b"- 0\n" * 200, b"---\n" * 2000),
    ],
)
def test_yaml_that_is_refused(content):
    with pytest.raises(ValueError):
        plain_yaml(content, 10, 100 if content.startswith(b"-") else 10**6)


@pytest.mark.parametrize(
    "content",
    [
        *(b"[" * 100_000, b"[[[[[[1]]]]]]", b"[NaN]", b"[-Infinity]", b'{"a": 1, "a": 2}', b"9" * 401, b'"\\ud800"'),
        *(b"\xff", b"[1", b"", b"[0" + b",0" * 101 + b"]"),
    ],
)
def test_json_that_is_refused(content):
    with pytest.raises(ValueError):
        plain_json(content, 5, 100)
