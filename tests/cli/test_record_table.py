"""The table of a recording is drawn while threads of devices add to what it shows."""

from collections import Counter
from io import StringIO

from rich.console import Console

from glissando.cli.record import _table
from glissando.hardware.capture import Progress


class _Heard(Counter):
    """Counts in which a further topic is heard while a row is made of the first."""

    def __getitem__(self, topic):
        self["/mocap/new"] = 1
        return dict.__getitem__(self, topic)


def test_a_topic_that_is_heard_first_while_the_table_is_drawn_does_not_end_it():
    progress = Progress(total=10.0)
    progress.count = _Heard({"/slide": 3, "/tracker/early": 1})
    progress.last = {"/slide": "1 mm"}  # the other's is about to be written
    shown = StringIO()
    Console(file=shown, width=80).print(_table(progress))
    assert "/tracker/early" in shown.getvalue()
