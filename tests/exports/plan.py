"""Reads a plan file: its bytes as `shared/src/plan` describes them, its poses as `shared/src/displacement.rs` does."""

import dataclasses
import struct
import zlib

import numpy

import ur

KINDS = ["ur3e", "ur5e", "ur10e", "ur16e", "ur20", "ur30"]


@dataclasses.dataclass
class Plan:
    hash: int
    scene_digest: str
    version: str
    period_us: int
    lsb: tuple  # m, rad
    limits: dict
    positions: numpy.ndarray  # (ticks + 1, 3), m, world
    rotations: numpy.ndarray  # (ticks + 1, 3, 3), tool to world
    arm: ur.Arm | None

    @property
    def times_us(self):
        return self.period_us * numpy.arange(len(self.positions))


class Bytes:
    """Postcard: floats little-endian, whole numbers seven bits at a time, signed ones zigzag."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        self.at += count
        return self.data[self.at - count : self.at]

    def floats(self, count):
        return list(struct.unpack(f"<{count}d", self.take(8 * count)))

    def whole(self):
        value = shift = 0
        while True:
            byte = self.take(1)[0]
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    def signed(self):
        value = self.whole()
        return (value >> 1) ^ -(value & 1)


def rotation(vector):
    """Matrix of a rotation vector, by Rodrigues' formula."""
    angle = numpy.linalg.norm(vector)
    if angle == 0:
        return numpy.eye(3)
    x, y, z = vector / angle
    cross = numpy.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return numpy.eye(3) + numpy.sin(angle) * cross + 2 * numpy.sin(angle / 2) ** 2 * cross @ cross


def of_quaternion(w, x, y, z):
    """Matrix of a unit quaternion."""
    return numpy.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def turn(matrix):
    """Rotation vector of a matrix near the identity."""
    return numpy.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]) / 2


def framed(body):
    """4 x 4 matrix of a position and a unit quaternion."""
    matrix = numpy.eye(4)
    matrix[:3, 3] = body.floats(3)
    matrix[:3, :3] = of_quaternion(*body.floats(4))
    return matrix


def read(path):
    data = path.read_bytes()
    assert data[:8] == b"PWDLPLAN" and struct.unpack("<H", data[8:10]) == (4,), "magic and version"
    assert zlib.crc32(data[:-4]) == struct.unpack("<I", data[-4:])[0], "checksum"
    body = Bytes(data[10:-4])
    digest = body.take(32).hex()
    version = ".".join(str(body.whole()) for _ in range(3))
    body.whole(), body.whole()  # seed, precision
    body.floats(10), body.whole()  # skill, and how many numbers the motion leaves it by
    period_us, steps = body.whole(), body.whole()
    nano = (body.whole(), body.whole())
    start, orientation = numpy.array(body.floats(3)), of_quaternion(*body.floats(4))
    names = ["v", "a", "j", "w", "alpha", "zeta"]
    limits = {"min": body.floats(3), "max": body.floats(3), **dict(zip(names, body.floats(6)))}
    body.floats(1), body.signed(), body.floats(2)  # loss, indicator; masses wanted and of a particle
    for _ in range(6):  # particles by where they end
        body.whole()
    if body.whole():  # the same on a finer grid
        body.floats(3), [body.whole() for _ in range(6)]
    arm = None
    if body.whole():
        kind = KINDS[body.whole()]
        arm = ur.Arm(kind, framed(body), framed(body))
        body.take(3)  # posture
    counts = numpy.array([[body.signed() for _ in range(6)] for _ in range(steps)], dtype=object).cumsum(axis=0)
    assert body.at == len(body.data), "bytes after the last step"
    cumulative = numpy.vstack([numpy.zeros(6), (counts * numpy.array([nano[0]] * 3 + [nano[1]] * 3) / 1e9).astype(float)])
    return Plan(
        hash=fnv1a64(data),
        scene_digest=digest,
        version=version,
        period_us=period_us,
        lsb=tuple(count / 1e9 for count in nano),
        limits=limits,
        positions=start + cumulative[:, :3],
        rotations=numpy.array([rotation(vector) @ orientation for vector in cumulative[:, 3:]]),
        arm=arm,
    )


def fnv1a64(data):
    value = 0xCBF29CE484222325
    for byte in data:
        value = (value ^ byte) * 0x100000001B3 % (1 << 64)
    return value
