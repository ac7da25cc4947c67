"""Three kinds of editors against a publisher: no edit is lost while the file is rendered all the time."""

import threading

import pytest

from phyagentos.clock import SystemClock
from phyagentos.store.views.page_history import History
from phyagentos.store.views.sessions import END_MARK

from .edit_stand import EditStand
from .test_edits import NEW


def rename_over(file, text):
    temporary = file.with_name(".swp")
    temporary.write_text(text)
    temporary.replace(file)


def write_in_place(file, text):
    with file.open("r+") as writer:
        writer.truncate()
        for begin in range(0, len(text), 2000):
            writer.write(text[begin : begin + 2000])
            writer.flush()


def move_away(file, text):
    file.rename(file.with_name("S.md~"))
    file.write_text(text)


def read_whole(file):
    while True:
        try:
            text = file.read_text()
        except FileNotFoundError:
            continue
        if END_MARK in text:
            return text


def list_lost(root, save):
    clock = SystemClock()
    stand = EditStand(root / "w", clock)
    history, is_over = History(stand.pens["agent"].folder), threading.Event()

    def publish():
        while not is_over.wait(0.005):
            stand.edits.take_file(history)
            stand.edits.file.put(history.render(history.build_page()))

    publisher = threading.Thread(target=publish)
    publisher.start()
    ids = [f"edit-{number}" for number in range(20)]
    for id in ids:
        save(stand.file, read_whole(stand.file).replace(END_MARK, NEW.replace("by-hand", id) + END_MARK))
        clock.sleep(0.05)
    for _ in range(40):  # until each has its answer, or long enough
        if all(id in history.ledger.sessions for id in ids):
            break
        clock.sleep(0.05)
    is_over.set()
    publisher.join()
    history.read_new()
    lost = [id for id in ids if id not in history.ledger.sessions and f"## {id}\n" not in stand.rejected]
    history.close()
    stand.close()
    return lost


@pytest.mark.slow
@pytest.mark.timeout(120)
@pytest.mark.parametrize("save", [rename_over, write_in_place, move_away])
def test_no_edit_is_lost_while_the_file_is_rendered(tmp_path, save):
    assert list_lost(tmp_path, save) == []
