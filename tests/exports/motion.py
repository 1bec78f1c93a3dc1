"""Opens exported motions with programs that are not ours, and compares them with the plan that they are of.

    python3 tests/exports/motion.py [--spoil] [--arm KIND --base X,Y,Z,R,P,Y --tool X,Y,Z,R,P,Y] [--speed S] [--payload KG] PLAN DIR

DIR holds what `optimise export` made of PLAN: `skill.csv`, `skill.json`, `skill.mcap`; with an arm, the plan's own or this one,
`skill.script` as well; without one, and with its powder in `skill.mcap`, a folder `powder` with the same powder as
tables. The program is run by the interpreter in urscript.py and its joints turned into poses by ur.py; tables are opened with
pandas, messages with mcap and mcap-ros2-support. The plan is read by plan.py. Nothing of this knows the code that wrote the
files.

Prints the largest deviations. With --spoil single values are then changed in copies, and each change must be found.
"""

import argparse
import json
import math
import pathlib
import shutil
import struct
import sys
import tempfile

import numpy
import pandas
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory

import plan as plans
import ur
import urscript
from check import Differs, close, same, spoil_byte

# Numbers in text read back as the same bits; sines and roots are taken by other libraries.
SAME = 1e-14

# Splines are solved by elimination there and by a dense matrix here; speeds are up to a few rad/s.
SOLVED = 1e-11

JOINT_NAMES = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]


def slopes(values, period_s):
    """Derivatives at the ticks of the cubic spline through values that rests at both ends."""
    last = len(values) - 1
    matrix, right = numpy.eye(last + 1), numpy.zeros_like(values)
    for k in range(1, last):
        matrix[k, k - 1 : k + 2] = 1, 4, 1
        right[k] = 3 * (values[k + 1] - values[k - 1]) / period_s
    return numpy.linalg.solve(matrix, right)


def spline(values, period_s, times_s):
    """The cubic spline itself, by its second derivatives' other form: Hermite's polynomials."""
    at = numpy.minimum((times_s / period_s + 1e-9).astype(int), len(values) - 2)
    s = (times_s / period_s - at)[:, None]
    m = slopes(values, period_s) * period_s
    h = [(1 + 2 * s) * (1 - s) ** 2, s * (1 - s) ** 2, s * s * (3 - 2 * s), s * s * (s - 1)]
    return h[0] * values[at] + h[1] * m[at] + h[2] * values[at + 1] + h[3] * m[at + 1]


class Motion:
    """What must be in the files."""

    def __init__(self, plan, arm, speed=1.0, payload_kg=None):
        self.plan, self.arm, self.speed, self.payload_kg = plan, arm, speed, payload_kg
        self.period_s = plan.period_us / 1e6
        turns = [plans.turn(b @ a.T) for a, b in zip(plan.rotations, plan.rotations[1:])]
        # The sine is not the angle.
        turns = [t * (numpy.arcsin(n) / n if (n := numpy.linalg.norm(t)) else 1) for t in turns]
        ways = numpy.hstack([plan.positions, numpy.vstack([numpy.zeros(3), numpy.cumsum(turns, axis=0)])])
        self.velocities = slopes(ways, self.period_s)

    def tools(self, joints):
        """Position and orientation of the tool in the world for each row of joints."""
        matrices = numpy.array([self.arm.base @ self.arm.flange(row) @ self.arm.tool for row in joints])
        return matrices[:, :3, 3], matrices[:, :3, :3]

    def off_lsb(self, positions, rotations, ticks):
        """Largest deviation from the plan at these ticks, along any axis, in LSB: of translation, of rotation."""
        moved = abs(positions - self.plan.positions[ticks]).max()
        pairs = zip(rotations, self.plan.rotations[ticks])
        turned = max(abs(plans.turn(found @ expected.T)).max() for found, expected in pairs)
        return moved / self.plan.lsb[0], turned / self.plan.lsb[1]

    def on_the_plan(self, what, positions, rotations, ticks):
        off = self.off_lsb(positions, rotations, ticks)
        if not max(off) <= 0.5:
            raise Differs(f"{what}: {off[0]:.3g} and {off[1]:.3g} LSB off the plan, which is more than a half")
        return f"at most {off[0]:.1e} LSB of translation and {off[1]:.1e} LSB of rotation off the plan's ticks"


def derivatives(values, step_s):
    """Largest norms of velocity, acceleration and jerk from row to row, at rest before and after."""
    values = numpy.vstack([values[:1]] * 3 + [values] + [values[-1:]] * 3)
    found = []
    for _ in range(3):
        values = numpy.diff(values, axis=0) / step_s
        found.append(numpy.linalg.norm(values, axis=1).max())
    return found


def check_script(folder, motion):
    program = urscript.Program((folder / "skill.script").read_text())
    begin = check_refusals(program, motion.arm)
    arm = urscript.Arm(motion.arm, begin)
    same("skill.script: runs to its end", program.run(arm), True)
    once = list(arm.setpoints)
    same("skill.script: runs again", (program.run(arm), arm.setpoints), (True, once + once))
    plan, cycle_s = motion.plan, once[0][0]
    same("skill.script: cycles of another length", [t for t, _ in once if t != cycle_s], [])
    if motion.payload_kg is not None:
        same("skill.script: payload", arm.payload and arm.payload[0], motion.payload_kg)
    tool = numpy.array(arm.tcp)
    close("skill.script: tool centre point", tool[:3], motion.arm.tool[:3, 3], 1e-9, 1.0)
    close("skill.script: tool centre point", plans.rotation(tool[3:]), motion.arm.tool[:3, :3], 1e-8, 1.0)
    for _, acceleration, speed in arm.moves:
        if speed > 0.25 or acceleration > 0.5:
            raise Differs(f"skill.script: moves at {speed} rad/s, with {acceleration} rad/s^2")

    # From where it begins to the start, the motion, back; each with its end held.
    at = {text.removeprefix("Powderline: "): number for number, text in reversed(arm.messages)}
    (begins,) = {number for text, number in at.items() if text.startswith("slowly to the start")}
    ends = [begins, at["plays the motion"], at["back to where it began"], len(once)]
    approach, joints, retreat = (numpy.array([q for _, q in once[a:b]]) for a, b in zip(ends, ends[1:]))
    ways = check_ways(motion, arm, approach, numpy.vstack([joints[-1:], retreat]), cycle_s)
    joints = numpy.vstack([approach[-1:], joints])
    cycles = round(plan.times_us[-1] / 1e6 / motion.speed / cycle_s)
    held = joints[cycles:]
    if len(held) * cycle_s < 0.25:
        raise Differs(f"skill.script: the end is held for {len(held) * cycle_s} s only")
    close("skill.script: joints while the end is held", held, held[:1].repeat(len(held), 0), 1e-15, 1.0)
    joints = joints[: cycles + 1]

    # Every so many cycles there is a tick.
    times_us = numpy.round(1e6 * motion.speed * cycle_s * numpy.arange(len(joints))).astype(int)
    at_tick = times_us % plan.period_us == 0
    positions, rotations = motion.tools(joints)
    ticks = times_us[at_tick] // plan.period_us
    text = motion.on_the_plan("skill.script", positions[at_tick], rotations[at_tick], ticks)
    if plan.period_us % round(1e6 * motion.speed * cycle_s) == 0:
        same("skill.script: ticks that were passed", len(ticks), len(plan.positions))

    smooth = check_joints(motion.arm, joints, cycle_s)
    between = check_between(motion, positions, rotations, times_us / 1e6, cycle_s)
    return f"{len(joints) - 1} setpoints: {text}; {smooth}; {between}; {ways}"


def check_ways(motion, arm, approach, retreat, cycle_s):
    """Straight down to the start and straight up from the end, back to where it began, within half of the limits."""
    plan, homed = motion.plan, len(arm.moves) > 2
    # Twice run: from home and back there, or to where it begins.
    same("skill.script: moves", len(arm.moves), 6 if homed else 2)
    begin, first = arm.moves[0][0], arm.moves[1 if homed else 0][0]
    same("skill.script: goes back", arm.moves[2 if homed else 1][0], begin)
    same("skill.script: stops", len(arm.stops), 2 * 3)
    approach = numpy.vstack([[first], approach])
    close("skill.script: ends where it began", retreat[-1], first, 1e-9, 1.0)
    heights = []
    for way in (approach, retreat):
        check_joints(motion.arm, way, cycle_s)
        positions, rotations = motion.tools(way)
        check_limits("skill.script: way", motion, positions, rotations, cycle_s, 0.5 * motion.speed)
        heights.append(positions[:, 2])
    positions, rotations = motion.tools(approach)
    low = abs(positions - plan.positions[0])
    close("skill.script: down to the start", positions[:, :2], plan.positions[:1, :2].repeat(len(positions), 0), 1e-6, 1.0)
    close("skill.script: turned as at the start", rotations, plan.rotations[:1].repeat(len(rotations), 0), 1e-6, 1.0)
    close("skill.script: at the start", positions[-1], plan.positions[0], plan.lsb[0], 1.0)
    positions, rotations = motion.tools(retreat)
    up = positions[:, 2] < positions[:, 2].max() - 1e-6
    aside = abs(positions[up][:, :2] - plan.positions[-1, :2]).max(initial=0.0)
    turned = abs(rotations[up] - plan.rotations[-1]).max(initial=0.0)
    if not max(aside, turned) <= 1e-6 or (numpy.diff(heights[1]) < -1e-6).any() or (numpy.diff(heights[0]) > 1e-9).any():
        raise Differs(f"skill.script: on its way up {aside} m aside, turned by {turned}, or not only up")
    return f"{1e3 * low[0, 2]:.0f} mm down to the start, and back over {1e3 * heights[1][-1]:.0f} mm to the same joints"


def check_joints(arm, joints, cycle_s):
    """Range and speed; speeds that change from cycle to cycle no faster than over a whole tick: no jumps."""
    speeds = numpy.diff(numpy.vstack([joints[:1], joints, joints[-1:]]), axis=0) / cycle_s
    if not (abs(joints) <= ur.RANGE).all() or not (abs(speeds) <= arm.speeds).all():
        raise Differs(f"skill.script: joints up to {abs(joints).max()} rad and {abs(speeds).max()} rad/s")
    jump = abs(numpy.diff(speeds, axis=0)).max()
    longer = abs(speeds[5:] - speeds[:-5]).max()
    if not jump <= 0.4 * longer:
        raise Differs(f"skill.script: a joint's speed jumps by {jump} rad/s, but in five cycles by {longer} rad/s only")
    return f"joints at most {abs(speeds).max():.3f} rad/s, changing by at most {jump:.4f} rad/s from cycle to cycle"


def check_limits(what, motion, positions, rotations, cycle_s, speed):
    """Shares of the plan's limits that are used, which a motion at so much of the speed uses the less of."""
    limits, lsb = motion.plan.limits, motion.plan.lsb[0]
    low, high = (numpy.array(limits[side]) for side in ("min", "max"))
    if not ((positions >= low - lsb) & (positions <= high + lsb)).all():
        raise Differs(f"{what}: leaves the workspace")
    turns = [plans.turn(b @ a.T) for a, b in zip(rotations, rotations[1:])]
    angles = numpy.vstack([numpy.zeros(3), numpy.cumsum(turns, axis=0)])
    used = [*derivatives(positions, cycle_s), *derivatives(angles, cycle_s)]
    shares = [value / limits[name] for value, name in zip(used, ("v", "a", "j", "w", "alpha", "zeta"))]
    if not max(shares) <= 1.001 * speed:
        raise Differs(f"{what}: uses {shares} of the plan's limits")
    return shares


def check_between(motion, positions, rotations, times_s, cycle_s):
    """The tool keeps the plan's limits from cycle to cycle, and goes the way of the spline through the plan's positions."""
    lsb = motion.plan.lsb[0]
    shares = check_limits("skill.script", motion, positions, rotations, cycle_s, motion.speed)
    way = spline(motion.plan.positions, motion.period_s, times_s)
    off_nm = 1e9 * numpy.linalg.norm(positions - way, axis=1).max()
    if not off_nm <= 1e9 * lsb:
        raise Differs(f"skill.script: up to {off_nm} nm off the way between the ticks")
    percent = ", ".join(f"{100 * share:.0f} %" for share in shares)
    return f"{percent} of the plan's limits (v, a, j, angular too); between ticks {off_nm:.1f} nm off the tool's own spline"


def check_refusals(program, made_as):
    """An arm that is another, or stands elsewhere, or does not come to the start, is not given the motion. Joints where it begins."""
    away = urscript.Arm(made_as, [0.3] * 6)
    same("skill.script: halts far away", program.run(away), False)
    number, text = away.messages[-1]
    begin = [math.radians(float(angle)) for angle in text.split("in degrees: ")[1].split(",")]
    near = [angle + 0.03 for angle in begin]
    other, missing = urscript.Arm(made_as, near, size=1.05), urscript.Arm(made_as, near, misses_by=0.01)
    for arm in (other, missing):
        same("skill.script: halts", program.run(arm), False)
    for arm in (away, other):
        same("skill.script: moves when it halts", (arm.moves, arm.setpoints), ([], []))
    same("skill.script: plays when it halts", [text for _, text in missing.messages if "plays" in text], [])
    return near


def check_columns(what, table, motion):
    """Columns by their names: pose, velocities, joints, speeds."""
    column = lambda *names: numpy.array([table[name] for name in names], dtype=float).T
    plan, ticks = motion.plan, numpy.arange(len(motion.plan.positions))
    close(f"{what}: times", column("time_s")[:, 0], plan.times_us / 1e6, 0.0, 1.0)
    rotations = numpy.array([plans.of_quaternion(*q) for q in column("qw", "qx", "qy", "qz")])
    positions = column("x_m", "y_m", "z_m")
    close(f"{what}: positions", positions, plan.positions, SAME, 1.0)
    close(f"{what}: orientations", rotations, plan.rotations, SAME, 1.0)
    text = motion.on_the_plan(what, positions, rotations, ticks)
    velocities = column("vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s")
    close(f"{what}: velocities", velocities, motion.velocities, SOLVED, 1.0)
    if not motion.arm:
        return f"tool {text}"
    joints = column(*(f"joint{joint}_rad" for joint in range(1, 7)))
    by_joints = motion.on_the_plan(f"{what}: joints", *motion.tools(joints), ticks)
    speeds = column(*(f"joint{joint}_rad_s" for joint in range(1, 7)))
    close(f"{what}: joints' speeds", speeds, slopes(joints, motion.period_s), SOLVED, 1.0)
    return f"tool {text}; joints put it {by_joints}"


def check_csv(folder, motion):
    table = pandas.read_csv(folder / "skill.csv")
    same("skill.csv: columns", len(table.columns), 26 if motion.arm else 14)
    return check_columns("skill.csv", table, motion)


def check_json(folder, motion):
    document, plan = json.loads((folder / "skill.json").read_text()), motion.plan
    same("skill.json: plan", document["plan_hash"], f"{plan.hash:016x}")
    same("skill.json: scene", document["scene_digest"], plan.scene_digest)
    same("skill.json: version", document["optimiser_version"], plan.version)
    same("skill.json: steps", (document["period_s"], document["steps"]), (motion.period_s, len(plan.positions) - 1))
    same("skill.json: LSB", (document["translation_lsb_m"], document["rotation_lsb_rad"]), plan.lsb)
    same("skill.json: columns", len(document["motion"]), 26 if motion.arm else 14)
    same("skill.json: arm", (document["arm"] or {}).get("model"), motion.arm and motion.arm.kind)
    arm = (("world_from_base", motion.arm.base), ("flange_from_tool", motion.arm.tool)) if motion.arm else ()
    for name, expected in arm:
        found = document["arm"][name]
        close(f"skill.json: {name}", found["position_m"], expected[:3, 3], SAME, 1.0)
        close(f"skill.json: {name}", plans.of_quaternion(*found["orientation_wxyz"]), expected[:3, :3], SAME, 1.0)
    return check_columns("skill.json", document["motion"], motion)


def messages(path):
    """Decoded messages by topic, each with its time in microseconds; what the file says of itself."""
    topics, kinds = {}, {}
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        same(f"{path.name}: profile", reader.get_header().profile, "ros2")
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            same(f"{path.name}: encoding", (schema.encoding, channel.message_encoding), ("ros2msg", "cdr"))
            same(f"{path.name}: time", message.log_time % 1000, 0)
            topics.setdefault(channel.topic, []).append((message.log_time // 1000, decoded))
            kinds[channel.topic] = schema.name
    return topics, kinds, metadata["powderline"]


def microseconds(time):
    return time.sec * 1_000_000 + time.nanosec // 1000


def vector(part):
    return [part.x, part.y, part.z]


def matrix(part):
    return plans.of_quaternion(part.w, part.x, part.y, part.z)


KINDS = {"/tool_pose": "geometry_msgs/msg/PoseStamped", "/tf": "tf2_msgs/msg/TFMessage"}
KINDS_OF_ARM = {"/joint_trajectory": "trajectory_msgs/msg/JointTrajectory", "/joint_states": "sensor_msgs/msg/JointState"}
KINDS_OF_POWDER = {"/powder": "sensor_msgs/msg/PointCloud2"}


def check_mcap(folder, motion):
    name, powder = "skill.mcap", folder / "powder"
    topics, kinds, about = messages(folder / name)
    plan, times_us = motion.plan, motion.plan.times_us.tolist()
    same(f"{name}: topics", kinds, KINDS | (KINDS_OF_ARM if motion.arm else KINDS_OF_POWDER))
    same(f"{name}: plan and scene", (about["plan_hash"], about["scene_digest"]), (f"{plan.hash:016x}", plan.scene_digest))
    for topic in topics.keys() - {"/joint_trajectory", "/powder"}:
        same(f"{name}: times of {topic}", [time for time, _ in topics[topic]], times_us)
    ticks = numpy.arange(len(times_us))
    text = f"tool {motion.on_the_plan(name, *check_poses(name, topics, times_us), ticks)}"
    check_transforms(name, topics["/tf"], motion)
    if motion.arm:
        joints = check_trajectory(name, topics, motion)
        text += f"; joints put it {motion.on_the_plan(f'{name}: joints', *motion.tools(joints), ticks)}"
    else:
        text += check_powder(name, topics["/powder"], powder)
    return f"{sum(map(len, topics.values()))} messages: {text}"


def check_poses(name, topics, times_us):
    poses = [message for _, message in topics["/tool_pose"]]
    same(f"{name}: frames", {pose.header.frame_id for pose in poses}, {"world"})
    same(f"{name}: stamps", [microseconds(pose.header.stamp) for pose in poses], times_us)
    positions = numpy.array([vector(pose.pose.position) for pose in poses])
    return positions, numpy.array([matrix(pose.pose.orientation) for pose in poses])


def check_transforms(name, messages_, motion):
    base = [("base", motion.arm.base[:3, 3], motion.arm.base[:3, :3])] if motion.arm else []
    for tick, (time_us, message) in enumerate(messages_):
        frames = [("tool", motion.plan.positions[tick], motion.plan.rotations[tick]), *base]
        same(f"{name}: transforms", len(message.transforms), len(frames))
        for found, (frame, position, rotation) in zip(message.transforms, frames):
            header = (found.header.frame_id, found.child_frame_id, microseconds(found.header.stamp))
            same(f"{name}: transform", header, ("world", frame, time_us))
            close(f"{name}: translation", vector(found.transform.translation), position, SAME, 1.0)
            close(f"{name}: rotation", matrix(found.transform.rotation), rotation, SAME, 1.0)


def check_trajectory(name, topics, motion):
    """Joints of the trajectory, which are those of the states."""
    ((_, trajectory),) = topics["/joint_trajectory"]
    states = [state for _, state in topics["/joint_states"]]
    names = [f"{joint}_joint" for joint in JOINT_NAMES]
    same(f"{name}: names of joints", list(trajectory.joint_names), names)
    same(f"{name}: names of joints", [state for state in states if list(state.name) != names], [])
    points = trajectory.points
    times_us = [microseconds(point.time_from_start) for point in points]
    same(f"{name}: times of the trajectory", times_us, motion.plan.times_us.tolist())
    same(f"{name}: stamps", [microseconds(state.header.stamp) for state in states], times_us)
    joints = numpy.array([list(point.positions) for point in points])
    speeds = numpy.array([list(point.velocities) for point in points])
    close(f"{name}: speeds", speeds, slopes(joints, motion.period_s), SOLVED, 1.0)
    same(f"{name}: speeds at both ends", (speeds[0].any(), speeds[-1].any()), (False, False))
    close(f"{name}: joint states", [list(state.position) for state in states], joints, 0.0, 1.0)
    close(f"{name}: joint states", [list(state.velocity) for state in states], speeds, 0.0, 1.0)
    return joints


def check_powder(name, clouds, folder):
    """The clouds against the tables of the same powder."""
    table = pandas.read_csv(folder / "particles.csv")
    frames = [rows for _, rows in table.groupby("time_s")]
    same(f"{name}: times of the powder", [time for time, _ in clouds], [round(1e6 * rows.time_s.iloc[0]) for rows in frames])
    for (_, cloud), rows in zip(clouds, frames):
        fields = [(field.name, field.offset, field.datatype, field.count) for field in cloud.fields]
        same(f"{name}: fields", fields, [(axis, 4 * at, 7, 1) for at, axis in enumerate(["x", "y", "z", "vx", "vy", "vz"])])
        count = len(rows)
        shape = (cloud.height, cloud.width, cloud.point_step, cloud.row_step, cloud.is_bigendian, cloud.is_dense)
        same(f"{name}: shape", shape, (1, count, 24, 24 * count, False, True))
        found = numpy.frombuffer(bytes(cloud.data), "<f4").reshape(count, 6)
        expected = rows[["x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s"]].to_numpy().astype(numpy.float32)
        same(f"{name}: numbers that differ", int((found != expected).sum()), 0)
    return f"; {len(clouds)} clouds of {len(frames[0])} particles, the same as in the tables"


CHECKS = {"skill.script": check_script, "skill.csv": check_csv, "skill.json": check_json, "skill.mcap": check_mcap}


def checks_of(motion):
    return {name: check for name, check in CHECKS.items() if motion.arm or name != "skill.script"}


def spoil_text(path, old, new, after=""):
    """Replaces the first occurrence after a text."""
    text = path.read_text()
    at = text.index(after)
    path.write_text(text[:at] + text[at:].replace(old, new, 1))


def spoil_line(path, number, change):
    lines = path.read_text().splitlines(keepends=True)
    lines[number : number + 1] = change(lines[number])
    path.write_text("".join(lines))


def tick_line(path, tick, after="plays the motion"):
    """Number of the line that holds a tick of a part."""
    lines = path.read_text().splitlines()
    begins = next(number for number, line in enumerate(lines) if after in line)
    return [number for number, line in enumerate(lines) if number > begins and line.startswith("  powderline_tick(")][tick]


def shifted(line, by):
    """A line whose first number is larger."""
    at = line.index("[") + 1
    end = line.index(",", at)
    return [f"{line[:at]}{float(line[at:end]) + by:.12f}{line[end:]}"]


def spoil_number(path, row, name, by):
    table = pandas.read_csv(path)
    table.loc[row, name] += by
    table.to_csv(path, index=False)


def spoil_json(path, name, tick, by):
    document = json.loads(path.read_text())
    document["motion"][name][tick] += by
    path.write_text(json.dumps(document))


def spoil_message(path, topic, number, change):
    """Writes the file anew, with the bytes of one message changed and checksums that fit."""
    with open(path, "rb") as file:
        reader = make_reader(file)
        header, metadata, found = reader.get_header(), list(reader.iter_metadata()), list(reader.iter_messages())
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start(header.profile, header.library)
        for record in metadata:
            writer.add_metadata(record.name, record.metadata)
        schemas, channels = {}, {}
        for schema, channel, message in found:
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                of = schemas[schema.id]
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, of, channel.metadata)
            changed = channel.topic == topic and message.sequence == number
            data = change(message.data) if changed else message.data
            at = (message.log_time, data, message.publish_time, message.sequence)
            writer.add_message(channels[channel.id], *at)
        writer.finish()


def other_double(at, by):
    """Changes the double at an offset."""
    return lambda data: data[:at] + struct.pack("<d", struct.unpack_from("<d", data, at)[0] + by) + data[at + 8 :]


def other_byte(from_end):
    return lambda data: data[:-from_end] + bytes([data[-from_end] ^ 1]) + data[len(data) - from_end + 1 :]


def spoilings(motion, rows):
    """What is changed, in which file, and how."""
    script, table, document, bag = "skill.script", "skill.csv", "skill.json", "skill.mcap"
    tick = rows // 3
    at = lambda path: tick_line(path, tick)
    # After encoding (4 bytes), stamp and frame the doubles begin where eight bytes fit: x, y, z.
    height = 4 + 24 + 2 * 8
    always = [
        ("a position by 10 nm", table, lambda p: spoil_number(p, tick, "x_m", 1e-8)),
        ("a time", table, lambda p: spoil_number(p, tick, "time_s", 1e-6)),
        ("an angular velocity", table, lambda p: spoil_number(p, tick, "wy_rad_s", 1e-6)),
        ("a quaternion", document, lambda p: spoil_json(p, "qw", tick, 1e-7)),
        ("the plan's hash", document, lambda p: spoil_text(p, '"plan_hash":"', '"plan_hash":"0')),
        ("nothing but a bit", bag, lambda p: spoil_byte(p, p.stat().st_size // 2)),
        ("its end", bag, lambda p: p.write_bytes(p.read_bytes()[:-5000])),
        ("a position by 0.1 um", bag, lambda p: spoil_message(p, "/tool_pose", tick, other_double(height, 1e-7))),
        ("a stamp", bag, lambda p: spoil_message(p, "/tf", tick, lambda data: data[:8] + bytes([data[8] + 1]) + data[9:])),
    ]
    if not motion.arm:
        # The last number of the last particle, behind which is whether all are numbers.
        return always + [("a particle", bag, lambda p: spoil_message(p, "/powder", 3, other_byte(4)))]
    return always + [
        ("a joint by a quarter of a microradian", script, lambda p: spoil_line(p, at(p), lambda line: shifted(line, 2.5e-7))),
        ("a tick left out", script, lambda p: spoil_line(p, at(p), lambda line: [])),
        ("a tick twice", script, lambda p: spoil_line(p, at(p), lambda line: [line, line])),
        ("a speed", script, lambda p: spoil_line(p, at(p), lambda line: [line.replace("], [", "], [9 + ")])),
        ("the cubic", script, lambda p: spoil_text(p, "3.0 * d", "2.9 * d")),
        ("the setpoint", script, lambda p: spoil_text(p, "servoj(powderline_q + s", "servoj(1.001 * powderline_q + s")),
        ("the start", script, lambda p: spoil_text(p, "powderline_q = [", "powderline_q = [0.1 + ")),
        ("the look at the start", script, lambda p: spoil_text(p, "halt", "textmsg(1)", after="not at the start")),
        ("the look where it stands", script, lambda p: spoil_text(p, "halt", "textmsg(1)", after="in degrees")),
        ("the way down", script, lambda p: spoil_line(p, tick_line(p, 5, "slowly to"), lambda line: shifted(line, 1e-4))),
        ("the way back", script, lambda p: spoil_line(p, tick_line(p, 5, "back to"), lambda line: shifted(line, 1e-4))),
        ("the end of the way back", script, lambda p: spoil_line(p, tick_line(p, -1, "back to"), lambda line: shifted(line, 1e-6))),
        ("the tool centre point", script, lambda p: spoil_text(p, "set_tcp(p[", "set_tcp(p[0.01 + ")),
        ("the look at the arm", script, lambda p: spoil_text(p, "halt", "textmsg(1)", after="the motion is not played")),
        ("a bracket", script, lambda p: spoil_text(p, "])", "]", after="  powderline_tick([")),
        ("the way to the start", script, lambda p: spoil_text(p, "v=0.2", "v=2.0")),
        ("a joint", table, lambda p: spoil_number(p, tick, "joint3_rad", 1e-7)),
        ("a joint's speed", document, lambda p: spoil_json(p, "joint5_rad_s", tick, 1e-6)),
        # Joints end 8 + 6 * 8 + 4 bytes before a state does, with speeds and no effort behind them.
        ("a joint's state", bag, lambda p: spoil_message(p, "/joint_states", tick, other_byte(4 + 8))),
        ("the trajectory", bag, lambda p: spoil_message(p, "/joint_trajectory", 0, other_byte(5000))),
    ]


NOTICED = (Differs, OSError, ValueError, TypeError, McapError, urscript.ScriptError)


def check_spoilt(made, motion):
    unnoticed = []
    for what, name, spoil in spoilings(motion, len(motion.plan.positions)):
        with tempfile.TemporaryDirectory() as copy:
            path = pathlib.Path(shutil.copy(made / name, copy))
            if (made / "powder").exists():
                shutil.copytree(made / "powder", path.parent / "powder")
            spoil(path)
            try:
                CHECKS[name](path.parent, motion)
                unnoticed.append(f"{name}, spoilt ({what}): not noticed")
            except NOTICED as noticed:
                print(f"{name}, spoilt ({what}): noticed: {str(noticed)[:70]}")
    return unnoticed


def six(text):
    numbers = [float(part) for part in text.split(",")]
    assert len(numbers) == 6, text
    return numbers


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spoil", action="store_true")
    parser.add_argument("--arm", choices=ur.ARMS)
    parser.add_argument("--base", type=six)
    parser.add_argument("--tool", type=six)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--payload", type=float)
    parser.add_argument("plan", type=pathlib.Path)
    parser.add_argument("made", type=pathlib.Path)
    words = parser.parse_args()
    plan = plans.read(words.plan)
    given = words.arm and ur.Arm(words.arm, ur.placed(*words.base), ur.placed(*words.tool))
    motion = Motion(plan, given or plan.arm, words.speed, words.payload)
    failures = []
    for name, check in checks_of(motion).items():
        try:
            print(f"{name}: {check(words.made, motion)}")
        except NOTICED as error:
            failures.append(f"{name}: {error}")
    if words.spoil and not failures:
        failures = check_spoilt(words.made, motion)
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
