import pytest

from camless_ctrl.report import ChapterResult, Column, Link, Number, Table, Text


def test_numbers_carry_their_unit_into_the_text():
    text = Text("{a:.1f} at {b:.0f}, {c:+.2f} and {name}", a=Number(1.26, "mg"),
                b=Number(17, "°"), c=Number(-0.5), name="x")  # fmt: skip
    assert str(text) == "1.3\u00a0mg at 17°, \u22120.50 and x"
    assert f"{Number(1.43e-3, 'm'):.2e}, {Number(-float('inf'))}" == "1.43·10⁻³\u00a0m, \u2212∞"
    assert set(text.numbers) == {"a", "b", "c"}


def test_braces_in_a_value_are_plain_text():
    assert str(Text("engine {name}", name="{0.__class__}")) == "engine {0.__class__}"


def test_cells_are_shown_by_their_column():
    column = Column("x", "mg", ".2f", words=("reproduced", "not reproduced"))
    table = Table("t", Text("T"), [column], [[1.0], [None], [-2], [3.14159]])
    shown = [table.shown(column, row[0]) for row in table.rows]
    assert shown == ["1.00", "–", "\u22122.00", "3.14"]
    assert table.shown(column, True) == "reproduced"
    assert table.shown(column, Link("there", "id")) == "there"
    assert table.is_value(0)
    assert not Table("t", Text("T"), [column], [[True], [False]]).is_value(0)
    assert not Table("t", Text("T"), [column], []).is_value(0)


def test_a_row_of_the_wrong_length_is_refused():
    with pytest.raises(ValueError, match="2 cells, but the table has 1 columns"):
        Table("t", Text("T"), [Column("x")], [[1.0, 2.0]])


def test_one_name_for_two_numbers_is_refused():
    finding = Text("{x:.0f}", x=Number(1, "mg"))
    with pytest.raises(ValueError, match=r"number 'x' is 1\smg in one place.*2\smg"):
        ChapterResult(finding=finding, blocks=[Text("{x:.0f}", x=Number(2, "mg"))])
    same = ChapterResult(finding=finding, blocks=[Text("{x:.3f}", x=Number(1, "mg"))])
    assert same.all_numbers == {"x": Number(1, "mg")}
