"""Tables of text of any spreadsheet: cells by the names of their columns."""

import pytest

from rig.errors import FormatError
from rig.files.text_rows import read_rows, rows_of_text


@pytest.mark.parametrize(
    "text",
    [
        "a,b\n1,x y\n\n2,\n",
        "sep=;\na;b\n1;x y\n2;\n",
        ' a \tb\n1\t"x y"\n2\n',
        "a,b,\r\n1, x y ,\r\n,,\r\n2,,\r\n",
        "\na,b\n1,x y\n2,\n",
        ",,\n\r\n , \na,b\n1,x y\n2,\n",
        ';;\n"sep=;"\n;;\na;b\n1;x y\n2;\n',
        "sep=;\ra;b\r1;x y\r2;\r",
        "sep=|\na|b\n1|x y\n2|\n",
        '"a","b"\r"1","x y"\r\r"2",""\r',
    ],
)
def test_cells_are_read_by_the_names_of_their_columns(text):
    header, rows = rows_of_text(text, "t.csv")
    assert header[:2] == ["a", "b"]
    assert [(row["a"], row["b"]) for row in rows] == [("1", "x y"), ("2", "")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a\n1\n", "t.csv: lacks the column b; it needs a, b"),
        ("a,b\n1,2\n1,2,3\n", "t.csv, row 2: more cells than the 2 of the header"),
        ("a,b,c,b\n1,2,3,4\n", "t.csv: column 'b' is there twice; keep one"),
        ("c,a,b,c\n1,2,3,4\n", "t.csv: column 'c' is there twice; keep one"),
        ("a,b\n1,2\n3,4\n5,6\n", "t.csv: more than 2 rows; divide it"),
        ("a,b\n" + "x" * 200_000, "t.csv, row 1: cannot be read as CSV"),
    ],
)
def test_what_is_no_such_table_is_refused_in_one_line(text, message):
    with pytest.raises(FormatError) as caught:
        rows_of_text(text, "t.csv", needed=("a", "b"), once=("c",), most=2)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)


def test_names_of_columns_may_be_in_lower_case(tmp_path):
    assert rows_of_text("Audio,OUT\na,b\n", "t", lower=True)[1] == [{"audio": "a", "out": "b"}]
    (tmp_path / "t.csv").write_bytes("ä,b\n1,2\n".encode("utf-16"))
    assert read_rows(tmp_path / "t.csv", 100) == (["ä", "b"], [{"ä": "1", "b": "2"}])
