"""Files are written whole or not at all."""

import pytest

from dronepose._files import beside, write_bytes, write_text


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_appears_when_it_is_complete(tmp_path):
    target = tmp_path / "a.png"
    with beside(target) as part:
        assert (part.parent, part.suffix) == (tmp_path, ".png")
        assert part.name.startswith(".")
        part.write_bytes(b"half")
        assert not target.exists()
        part.write_bytes(b"all")
    assert target.read_bytes() == b"all"
    assert names(tmp_path) == ["a.png"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_what_was_there_stays_if_writing_fails(tmp_path, error):
    target = tmp_path / "a.csv"
    write_text(target, "before")

    def stopped():
        with beside(target) as part:
            part.write_text("half")
            raise error

    with pytest.raises(error):
        stopped()
    assert target.read_text() == "before"
    assert names(tmp_path) == ["a.csv"]


def test_text_is_utf8_with_its_own_ends_of_lines_in_a_new_folder(tmp_path):
    target = tmp_path / "new" / "a.txt"
    write_text(target, "ä\r\nb\n")
    assert target.read_bytes() == b"\xc3\xa4\r\nb\n"
    write_bytes(target, b"")
    assert target.read_bytes() == b""
    assert names(target.parent) == ["a.txt"]


def test_a_folder_in_the_way_is_named(tmp_path):
    (tmp_path / "a.txt").mkdir()
    with pytest.raises(OSError, match=r"a\.txt"):
        write_text(tmp_path / "a.txt", "text")
    assert names(tmp_path) == ["a.txt"]
