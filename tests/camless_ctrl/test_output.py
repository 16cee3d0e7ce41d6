import os
from pathlib import Path

import pytest

from camless_ctrl.output import OutputError, reserved_file, reserved_folder


def fill(staging: Path) -> None:
    (staging / "index.html").write_text("page")
    (staging / "report.json").write_text("{}")


def test_folder_is_made_with_its_parents(tmp_path):
    out = tmp_path / "a" / "b"
    with reserved_folder(out) as staging:
        fill(staging)
        assert not out.exists()
    assert sorted(p.name for p in out.iterdir()) == ["index.html", "report.json"]
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_other_files_of_an_existing_folder_stay_and_old_results_are_replaced(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "index.html").write_text("old")
    with reserved_folder(tmp_path) as staging:
        fill(staging)
    assert (tmp_path / "index.html").read_text() == "page"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["index.html", "notes.txt", "report.json"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
@pytest.mark.parametrize("existing", [True, False])
def test_interrupted_folder_leaves_nothing_behind(tmp_path, error, existing):
    out = tmp_path / "report"
    if existing:
        out.mkdir()
        (out / "index.html").write_text("old")

    def interrupted() -> None:
        with reserved_folder(out) as staging:
            fill(staging)
            raise error

    with pytest.raises(error):
        interrupted()
    if existing:
        assert [(p.name, p.read_text()) for p in out.iterdir()] == [("index.html", "old")]
    else:
        assert list(tmp_path.iterdir()) == []


def test_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "report").write_text("x")
    with (
        pytest.raises(OutputError, match=r"report is a file, but must be a folder: name"),
        reserved_folder(tmp_path / "report"),
    ):
        raise AssertionError("no work may begin")
    with (
        pytest.raises(OutputError, match="is a file, but must be a folder"),
        reserved_folder(tmp_path / "report" / "below"),
    ):
        raise AssertionError("no work may begin")


def test_folder_that_refuses_files_is_named_before_any_work(tmp_path, monkeypatch):
    # Permission bits do not stop the superuser, so the refusal itself is put in.
    def refuse(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    monkeypatch.setattr("tempfile.mkstemp", refuse)
    with (
        pytest.raises(OutputError, match=r"cannot be written \(Permission denied\): name") as told,
        reserved_folder(tmp_path / "report"),
    ):
        raise AssertionError("no work may begin")
    assert str(tmp_path) in str(told.value)
    with (
        pytest.raises(OutputError, match=r"cannot be written \(Permission denied\): name"),
        reserved_file(tmp_path / "x.json"),
    ):
        raise AssertionError("no work may begin")
    assert list(tmp_path.iterdir()) == []


def test_file_appears_whole_with_the_usual_permissions(tmp_path):
    path = tmp_path / "x.json"
    with reserved_file(path) as file:
        file.write("{}")
        assert not path.exists()
    assert path.read_text() == "{}"
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask
    assert list(tmp_path.iterdir()) == [path]


def test_interrupted_file_leaves_the_old_one(tmp_path):
    path = tmp_path / "x.json"
    path.write_text("old")

    def interrupted() -> None:
        with reserved_file(path) as file:
            file.write("new")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_file_in_a_missing_folder_or_on_a_folder_is_refused(tmp_path):
    with (
        pytest.raises(OutputError, match=r"does not exist.*create it or name another file"),
        reserved_file(tmp_path / "no" / "x.json"),
    ):
        raise AssertionError("no work may begin")
    with (
        pytest.raises(OutputError, match="is a folder, but must be a file"),
        reserved_file(tmp_path),
    ):
        raise AssertionError("no work may begin")


def test_no_file_asked_for():
    with reserved_file(None) as file:
        assert file is None
