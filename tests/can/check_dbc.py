#!/usr/bin/env python3
"""check_dbc.py [LOG]: holds shared/powderline.dbc against real frames, with cantools (pip install cantools).

Without LOG, the golden frames of shared/tests/golden: every classic frame must decode and encode back to its own bytes.
Setpoints must be those of the FD frames, which hold whole counts; words must have the names that the golden files and
PROTOCOL.md give them.

With LOG, what `candump -L` has written of a session on classic CAN: every frame of an identifier of ours must decode and
encode back, its words must have names, and the arm must have come to operation enabled. Frames of others are counted.

Exits with 1 at the first mismatch.
"""

import collections
import re
import struct
import sys
from pathlib import Path

import cantools

SHARED = Path(__file__).resolve().parents[2] / "shared"
TRANSLATION_MM, ROTATION_MRAD = 0.001, 0.01
HANDSHAKE = ("HandshakeToArm", "HandshakeFromArm")


def sections(name):
    """Pairs of a section's name and its frames as (identifier, data)."""
    text = (SHARED / "tests" / "golden" / name).read_text()
    for block in text.split("\n\n")[1:]:
        title, *lines = block.strip().split("\n")
        frames = [re.fullmatch(r"([0-9A-F]{3})(?:#|##1)([0-9A-F]*)", line).groups() for line in lines]
        yield title.removeprefix("# "), [(int(id, 16), bytes.fromhex(data)) for id, data in frames]


def expect(found, expected, where):
    if found != expected:
        sys.exit(f"{where}: {found!r} instead of {expected!r}")


def low_signed(count):
    """The low 16 bits of a count, read as the DBC does."""
    return struct.unpack("<h", struct.pack("<i", count)[:2])[0]


def check_counts(title, signals, fd_data):
    """The six values of a setpoint or an actual displacement."""
    names, lsb = ("X", "Y", "Z", "Rx", "Ry", "Rz"), [TRANSLATION_MM] * 3 + [ROTATION_MRAD] * 3
    for name, unit, count in zip(names, lsb, struct.unpack_from("<6i", fd_data, 12)):
        expect(round(signals[name] / unit), low_signed(count), f"{title}, {name}")
    expect(signals["Tick"], fd_data[4], f"{title}, tick")


def check_status(title, signals, fd_data):
    tick, word, have, counter = struct.unpack_from("<I4xHHB", fd_data, 4)
    expect(signals["AppliedTick"], tick & 0xFFFF, f"{title}, tick")
    expect((signals["Have"], signals["Counter"]), (have, counter), title)
    expect(signals["Standstill"], word >> 10 & 1, f"{title}, standstill")
    session = "without session" not in title
    expect((signals["InSession"], signals["InSessionToo"]), (session, session), f"{title}, session")
    name = title.removeprefix("from arm: status ").lower()
    if name in ("streaming", "completing", "holding"):
        expect((str(signals["State"]), str(signals["Phase"])), ("operation enabled", name), title)
    elif session:
        expect(str(signals["State"]), name, title)


def check_control(title, signals):
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", title.split()[3]).lower()
    expect(str(signals["Controlword"]), name, title)
    expect(signals["Session"], 0 if "without session" in title else 0x1234, f"{title}, session")


def check_fault_names(database):
    """The value table of fault codes is that of PROTOCOL.md."""
    rows = re.findall(r"^\| (\d{3}) +\| (.*?) \|$", (SHARED / "PROTOCOL.md").read_text(), re.M)
    choices = database.get_message_by_name("Fault").get_signal_by_name("FaultCode").choices
    expect({code: str(name) for code, name in choices.items()}, {int(code): name for code, name in rows}, "faults")


def named(signals, title):
    """The names of all signals that stand for a word; one without a name stands for nothing."""
    for signal in ("State", "Controlword", "ErrorCode", "FaultCode", "NmtState", "Word"):
        if isinstance(signals.get(signal), int):
            sys.exit(f"{title}: {signal} {signals[signal]:#x} has no name")
    return {name: str(value) for name, value in signals.items() if not isinstance(value, (int, float))}


def logged(path):
    """Frames of a log in candump's format: where, identifier, data."""
    for number, line in enumerate(path.read_text().splitlines(), start=1):
        found = re.fullmatch(r"\(\d+\.\d+\) \S+ ([0-9A-F]{3}|[0-9A-F]{8})#([0-9A-F]*)( [RT])?", line.strip())
        if found is None:
            sys.exit(f"{path}:{number}: not a classic frame as `candump -L` writes it: {line!r}")
        yield f"{path}:{number}", found[1], bytes.fromhex(found[2])


def check_log(database, path):
    """What the log says, in numbers."""
    ours = {f"{message.frame_id:03X}": message.frame_id for message in database.messages}
    counts, states, others = collections.Counter(), collections.Counter(), 0
    for where, identifier, data in logged(path):
        if identifier not in ours:
            others += 1
            continue
        signals = decoded(database, where, [(ours[identifier], data)])
        names = named(signals, where)
        counts[database.get_message_by_frame_id(ours[identifier]).name] += 1
        if "State" in names:
            states[names["State"]] += 1
    if "operation enabled" not in states:
        sys.exit(f"{path}: no status says operation enabled, only {sorted(states) or 'none at all'}")
    print(f"{counts.total()} frames decode, {others} are not ours: {', '.join(f'{n} {of}' for of, n in counts.items())}")
    print(f"States of the arm: {', '.join(f'{n} x {state}' for state, n in states.items())}")


def decoded(database, title, frames):
    """The signals of all frames of a section together, each frame encoded back."""
    signals = {}
    for identifier, data in frames:
        message = database.get_message_by_frame_id(identifier)
        short = message.name in HANDSHAKE
        found = message.decode(data, allow_truncated=short)
        if len(data) == message.length:
            expect(message.encode(found).hex(), data.hex(), f"{title}, encoded back")
        elif not short:
            sys.exit(f"{title}: {len(data)} bytes instead of {message.length}")
        signals |= found
    return signals


def main():
    database = cantools.database.load_file(SHARED / "powderline.dbc")
    check_fault_names(database)
    if len(sys.argv) > 2 or sys.argv[1:2] in (["-h"], ["--help"]):
        sys.exit(__doc__)
    if len(sys.argv) == 2:
        check_log(database, Path(sys.argv[1]))
    else:
        check_golden(database)


def check_golden(database):
    for which in ("", "-key"):
        check_pinned(database, f"wire-v3-classic{which}.txt", f"wire-v3-fd{which}.txt")


def check_pinned(database, classic_file, fd_file):
    fd = dict(sections(fd_file))
    checked, seen = 0, set()
    for title, frames in sections(classic_file):
        signals = decoded(database, title, frames)
        fd_data = fd[title][0][1]
        if "setpoint" in title or "actual" in title:
            check_counts(title, signals, fd_data)
        elif "status" in title:
            check_status(title, signals, fd_data)
        elif "control" in title:
            check_control(title, signals)
        elif "from arm: fault" in title:
            expect(signals["FaultCode"].value, struct.unpack_from("<H", fd_data, 12)[0], title)
        elif title == "from arm: heartbeat":
            expect((signals["Session"], signals["Lost"], signals["Dropped"]), (0x1234, 2, 513), title)
        elif title == "to arm: stop":
            expect(str(signals["Word"]), "stop", title)
        checked += len(frames)
        seen |= {identifier for identifier, _ in frames}
    expect(seen, {message.frame_id for message in database.messages}, "identifiers with golden frames")
    print(f"{checked} golden frames, {len(seen)} identifiers: powderline.dbc agrees")


if __name__ == "__main__":
    main()
