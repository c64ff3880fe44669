"""What is said of a log whose form is not a column for each signal."""

import re
from collections.abc import Sequence

from split_cli.logs.raw import RawChannelInfo, RawRecording
from split_cli.logs.readers.named_values import NAMES, VALUES


def hints_on_the_form(recording: RawRecording, infos: Sequence[RawChannelInfo]) -> tuple[str, ...]:
    """Return how to rewrite a table without titles, or one with a signal's name and value in each row.

    Parameters
    ----------
    infos : sequence of RawChannelInfo
        Its channels.
    """
    if infos and all(re.fullmatch(r"column\d+", info.name) for info in infos):
        if infos[0].type_name == "text":
            return (
                f"Each row of {recording.name} begins with a word. If that is the name of a message, write a "
                "table with titles for each (of a DataFlash log of ArduPilot: `mavlogdump.py --format csv "
                "--types IMU LOG > imu.csv`), and start again with all of them and --together. Else write a row "
                "of titles.",
            )
        unfit = next(
            (found[0] for n in recording.notes if (found := re.search(r"\d+ titles stand .* values", n.what))), ""
        )
        if unfit:
            return (
                f"{recording.name}: {unfit}. Give each row as many cells as there are titles: where the last ones are "
                "empty, their separators are needed too.",
            )
        return (
            f"{recording.name} has no row of titles: write one as its first line, with units, for instance "
            "`time [s],vx [m/s],yaw_rate [deg/s]`, and start again.",
        )
    listed = [info.name for info in infos if info.type_name.startswith(("list<", "large_list<", "fixed_size_list<"))]
    if len(listed) > 1:
        names = ", ".join(repr(name) for name in listed[:4]) + (", ..." if len(listed) > 4 else "")
        return (
            f"{recording.name} holds lists of numbers in its cells. Write a row for each number: in pandas, "
            f"table.explode([{names}]).to_parquet('flat.parquet').",
        )
    encoded = [note for note in recording.notes if "messages are encoded as" in note.what]
    if encoded and len(encoded) == len(infos):
        return tuple(f"{note.where} is {note.what}" for note in encoded[:3])
    texts = {info.name.strip().lower(): info.name for info in infos if info.type_name == "text"}
    numbers = {info.name.strip().lower(): info.name for info in infos if info.type_name != "text"}
    name = next((texts[n] for n in NAMES if n in texts), None)
    value = next((numbers[n] for n in VALUES if n in numbers), None)
    if name is None or value is None:
        return ()
    time = next((i.name for i in infos if "time" in i.name.lower() or i.name == "t"), "time")
    return (
        f"{recording.name} holds one value a row, with its name in {name!r}. Write a column for each name: in "
        f"pandas, table.pivot_table(index={time!r}, columns={name!r}, values={value!r}).to_csv('wide.csv').",
    )
