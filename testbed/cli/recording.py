"""`longreach recording`: what is in a recording, whether it is whole, and what can be made of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import JsonFile
from testbed.cli.root import CommandApp
from testbed.reporting.console import out, promised, table, write_json

if TYPE_CHECKING:
    from foundation.recording.recovery import Contents

_HELP = "What is in a recording, whether it is whole, what can be made of it."
app = CommandApp(help=_HELP, no_args_is_help=True)

File = Annotated[Path, typer.Argument(metavar="FILE", help="A recording, such as truth.mcap.")]


@app.callback()
def recording() -> None:
    """What is in a recording, whether it is whole, what can be made of it."""


@app.command(epilog="Example: longreach recording info runs/demo/plant_emulator/truth.mcap")
def info(file: File, json_file: JsonFile = None) -> None:
    """Topics, schemas, counts, rates and metadata of a recording, also of one that was cut off."""
    from foundation.recording.recovery import contents

    found = contents(file)
    _show(found)
    for name, entries in found.metadata.items():
        told = ", ".join(f"{key} {value if len(value) < 60 else '…'}" for key, value in entries.items())
        out.print(f"{name}: {told}", highlight=False)
    for attached in found.attachments:
        out.print(f"attached: {attached.name}, {len(attached.data)} bytes", highlight=False)
    write_json(json_file, _figures(found))


@app.command(epilog="Example: longreach recording verify runs/demo/plant_emulator/truth.mcap")
def verify(file: File, json_file: JsonFile = None) -> None:
    """Check every checksum; exit status 1 when the file is damaged or was cut off."""
    from foundation.recording.recovery import contents

    found = contents(file)
    for damage in found.damages:
        out.print(f"at byte {damage.offset}: {damage.what}", highlight=False)
    if found.stray:
        out.print(f"{found.stray} messages of channels that are not described", highlight=False)
    told = "whole" if _whole(found) else "not whole: `longreach recording recover` keeps what can be read"
    out.print(f"{found.messages} messages read; {told}", highlight=False)
    write_json(json_file, _figures(found))
    raise typer.Exit(0 if _whole(found) else 1)


@app.command("recover", epilog="Example: longreach recording recover truth.mcap --out whole.mcap")
def recover_command(
    file: File,
    target: Annotated[Path, typer.Option("--out", help="Where the whole file goes.")],
    json_file: JsonFile = None,
) -> None:
    """Write what can be read of a cut or damaged recording anew, with its index; tell what could not."""
    from foundation.recording.recovery import recover

    found = recover(file, promised(target))
    for damage in found.damages:
        out.print(f"lost at byte {damage.offset}: {damage.what}", highlight=False)
    out.print(f"{found.messages} messages, {_length(found):.1f} s in {target}", highlight=False)
    write_json(json_file, _figures(found))


@app.command("to-csv", epilog="Example: longreach recording to-csv truth.mcap --out tables")
def to_csv(
    file: File,
    directory: Annotated[Path, typer.Option("--out", help="Where the tables go.")],
    json_file: JsonFile = None,
) -> None:
    """One CSV file a topic, a column a number, times in nanoseconds."""
    from testbed.recordings.comparison import write_tables

    tables, left_out = write_tables(file, promised(directory))
    for name, made in tables.items():
        out.print(f"{directory / name}: {made.rows} rows of {made.topic}", highlight=False, markup=False)
    if left_out:
        why = "of an unknown encoding, or whose schema is not whole"
        out.print(f"left out, {why}: {', '.join(left_out)}", highlight=False, markup=False)
    rows = {name: made.rows for name, made in tables.items()}
    topics = {name: made.topic for name, made in tables.items()}
    write_json(json_file, {"rows": rows, "topics": topics, "left_out": left_out})


@app.command("pictures", epilog="Example: longreach recording pictures drive.mcap --out drive")
def pictures_command(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="A ROS bag: a directory, .mcap, .db3 or .bag.")],
    directory: Annotated[Path, typer.Option("--out", help="Where left/, right/ and calibration.yaml go.")],
    left: Annotated[str | None, typer.Option(help="Topic of the left eye's pictures.")] = None,
    right: Annotated[str | None, typer.Option(help="Topic of the right eye's pictures.")] = None,
    json_file: JsonFile = None,
) -> None:
    """Write a ROS bag's stereo pictures as the directories that odometry, camera check and hand-eye read."""
    from testbed.recordings.bags import extract_pictures
    from testbed.reporting.console import bars

    with bars() as shown, shown.step("reading the bag") as bar:
        found = extract_pictures(bag, (left, right), promised(directory), bar.update)
    for note in found.pairs.notes:
        out.print(note, highlight=False, soft_wrap=True)
    lens = found.calibration or "no calibration: pictures are raw, or have no camera_info"
    summary = (
        f"{len(found.pairs.files)} pairs of {found.topics[0]} and {found.topics[1]} in {directory}; {lens}"
    )
    out.print(summary, highlight=False, soft_wrap=True)
    figures = {"pairs": len(found.pairs.files), "topics": found.topics, "notes": found.pairs.notes}
    write_json(json_file, figures | {"calibration": found.calibration})


def _whole(found: "Contents") -> bool:
    return found.complete and not found.damages and not found.stray


def _length(found: "Contents") -> float:
    return (found.last_ns - found.first_ns) * 1e-9


def _show(found: "Contents") -> None:
    seconds = max(_length(found), 1e-9)
    rows = [
        (topic.name, topic.format.schema, count := found.counts.get(channel, 0), f"{count / seconds:.1f}")
        for channel, topic in found.topics.items()
    ]
    out.print(table("", ("topic", "schema", "messages", "a second"), rows))
    state = "whole" if _whole(found) else "not whole"
    out.print(f"{found.messages} messages, {_length(found):.1f} s, {state}", highlight=False)


def _figures(found: "Contents") -> dict[str, object]:
    counts = {topic.name: found.counts.get(channel, 0) for channel, topic in found.topics.items()}
    return {
        "messages": found.messages,
        "counts": counts,
        "seconds": _length(found),
        "whole": _whole(found),
        "complete": found.complete,
        "damages": [damage._asdict() for damage in found.damages],
        "stray": found.stray,
        "metadata": found.metadata,
    }
