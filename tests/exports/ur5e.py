"""Where the joints of a UR5e put its flange: the product of the links of UR's published Denavit-Hartenberg table."""

import numpy

# a (m), d (m), alpha (rad) of the UR5e, https://www.universal-robots.com, "DH Parameters for calculations of kinematics and
# dynamics".
LINKS = [
    (0.0, 0.1625, numpy.pi / 2),
    (-0.425, 0.0, 0.0),
    (-0.3922, 0.0, 0.0),
    (0.0, 0.1333, numpy.pi / 2),
    (0.0, 0.0997, -numpy.pi / 2),
    (0.0, 0.0996, 0.0),
]

# What the arm allows: rad to either side, rad/s.
RANGE, SPEED = 2 * numpy.pi, numpy.pi


def flange(joints):
    """4 x 4 matrix, base from flange."""
    matrix = numpy.eye(4)
    for angle, (a, d, alpha) in zip(joints, LINKS):
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
