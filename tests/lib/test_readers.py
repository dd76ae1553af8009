"""One reader for each format: what the library reads, it reads through `files` and `pictures`."""

from pathlib import Path

import pytest
from scene import refused

import omnistereo_lib as osl
from omnistereo_lib.errors import check_number
from omnistereo_lib.files import read_bytes, read_data, read_text
from omnistereo_lib.pictures import read_image

ROOT = Path(osl.__file__).parents[1]


def refuses(message, read, path):
    with refused(message) as error:
        read(path)
    assert str(path) in str(error.value) and len(str(error.value)) < 700


@pytest.mark.parametrize(
    ("content", "encoding"),
    [("a: 1  # ü", "utf-8"), ("a: 1  # ü", "utf-8-sig"), ("a: 1  # ü", "latin-1")],
)
def test_texts_of_three_encodings(tmp_path, content, encoding):
    path = tmp_path / "a.yaml"
    path.write_bytes(content.encode(encoding))
    assert read_text(path) == content and read_data(path) == {"a": 1}


BOMB = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 10)}]\n"
    for old, new in zip("abcdef", "bcdefg", strict=True)
)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.yaml", BOMB, "aliases repeat more than"),
        ("a.yaml", "a: &a [*a]\n", "aliases repeat more than"),
        ("a.yaml", "a: 1\nb: {c: 1, c: 2}\n", "'c' is stated twice"),
        ("a.json", '{"a": {"b": 1, "b": 2}}', "'b' is stated twice"),
        ("a.yaml", "[" * 20_000, "recursion"),
        ("a.json", "[" * 100_000, "recursion"),
        ("a.yaml", "a: !!python/object:os.system x", "holds Python objects"),
        ("a.yaml", f"a: {'9' * 5000}", "digits"),
        ("a.json", f"[{'9' * 5000}]", "digits"),
        ("a.json", "[" * 100 + "]" * 100, "nested more than 64 deep"),
        ("a.yaml", "[" * 100 + "]" * 100, "nested more than 64 deep"),
        ("a.yaml", "#" * (1 << 24) + "#", "expected a file of at most 16384 KiB"),
    ],
)
def test_data_that_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    refuses(message, read_data, tmp_path / name)


def test_aliases_and_headers_as_programs_write_them(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text(
        "%YAML:1.0\na: &k !!opencv-matrix {rows: 1, cols: 2, dt: d, data: [1., 2.]}\nb: *k\n"
    )
    matrix = {"rows": 1, "cols": 2, "dt": "d", "data": [1.0, 2.0]}
    assert read_data(path) == {"a": matrix, "b": matrix}


def test_what_is_no_file(tmp_path):
    import os

    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "pipe", Path("/dev/zero")):
        refuses("is a folder, a pipe or a device", read_image, path)
    refuses("cannot be read: No such file", read_bytes, tmp_path / "missing")
    refuses("cannot be read: File name too long", read_bytes, tmp_path / ("a" * 300))


@pytest.mark.parametrize("value", [1, 11, 2.5, float("nan"), float("inf"), "3", None, True, [3]])
def test_numbers_have_ranges(value):
    with refused(r"the count is .*; expected an integer of 2 to 10"):
        check_number(value, "the count", 2, 10, whole=True)
    assert check_number(3.0, "the count", 2, 10, whole=True) == 3
