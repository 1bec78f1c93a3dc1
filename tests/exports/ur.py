"""Where the joints of an arm of Universal Robots put its flange: the product of the links of the published
Denavit-Hartenberg table."""

import math

import numpy

# a of links 2 and 3, d of links 1, 4, 5 and 6 (m), https://www.universal-robots.com, "DH Parameters for calculations of kinematics
# and dynamics"; what its joints may do, rad/s.
TURN = math.pi
ARMS = {
    "ur3e": ((-0.24355, -0.2132), (0.15185, 0.13105, 0.08535, 0.0921), [TURN] * 3 + [2 * TURN] * 3),
    "ur5e": ((-0.425, -0.3922), (0.1625, 0.1333, 0.0997, 0.0996), [TURN] * 6),
    "ur10e": ((-0.6127, -0.57155), (0.1807, 0.17415, 0.11985, 0.11655), [TURN * 2 / 3] * 2 + [TURN] * 4),
}
# To either side, rad.
RANGE = 2 * math.pi


class Arm:
    """Which one, base in the world and tool in the flange (4 x 4)."""

    def __init__(self, kind, base, tool):
        self.kind, self.base, self.tool = kind, base, tool
        (a2, a3), (d1, d4, d5, d6), speeds = ARMS[kind]
        self.speeds = numpy.array(speeds)
        quarter = math.pi / 2
        self.links = [(0, d1, quarter), (a2, 0, 0), (a3, 0, 0), (0, d4, quarter), (0, d5, -quarter), (0, d6, 0)]

    def flange(self, joints):
        """4 x 4 matrix, base from flange."""
        matrix = numpy.eye(4)
        for angle, (a, d, alpha) in zip(joints, self.links):
            c, s, ca, sa = numpy.cos(angle), numpy.sin(angle), numpy.cos(alpha), numpy.sin(alpha)
            matrix = matrix @ numpy.array(
                [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
            )
        return matrix


def placed(x, y, z, roll, pitch, yaw):
    """4 x 4 matrix of a position (m) and of roll, pitch, yaw about fixed axes (degrees)."""
    matrix = numpy.eye(4)
    for axis, angle in enumerate(numpy.radians([roll, pitch, yaw])):
        turn = numpy.eye(4)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn[i, i] = turn[j, j] = numpy.cos(angle)
        turn[j, i] = numpy.sin(angle)
        turn[i, j] = -turn[j, i]
        matrix = turn @ matrix
    matrix[:3, 3] = x, y, z
    return matrix
