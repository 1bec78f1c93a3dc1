#!/usr/bin/env python3
"""outside_client.py INTERFACE [--key FILE]: moves an arm over classic SocketCAN, knowing nothing but shared/PROTOCOL.md.

Written with python-can (pip install python-can) and no line of the product, so that it fails where the document does not
say what the arm does. It expects a fresh arm, for instance `firmware-sim --on can:vcan0`, and

1. opens a session, enables the arm, plays 2 cm and 0.1 rad in 60 ticks of 10 ms, sees it hold the very counts of the end,
   and shuts down;
2. is refused the same session once more, opens the next one, whose anchor must be where the first one ended, stops
   the arm in mid-motion by the stop frame, sees the stop latched and resets it with the nonce that the arm has given out.

With a key, which the arm must have too, it is first refused for asking without one. Every frame of the arm must decode. Exits with 1 and one sentence at the first mismatch.
"""

import argparse
import math
import random
import secrets
import struct
import sys
import time
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import can

# Identifiers.
STOP, FAULT, STATUS, CONTROL = 0x001, 0x081, 0x181, 0x401
SETPOINT_T, SETPOINT_R, ACTUAL_T, ACTUAL_R = 0x201, 0x301, 0x281, 0x381
FROM_ARM, TO_ARM, ARM_HEARTBEAT, OWN_HEARTBEAT = 0x581, 0x601, 0x701, 0x77F

# Controlwords.
SHUTDOWN, SWITCH_ON, ENABLE_OPERATION = 0x0006, 0x0007, 0x000F

STATES = {
    0x00: "not ready to switch on",
    0x40: "switch on disabled",
    0x21: "ready to switch on",
    0x33: "switched on",
    0x37: "operation enabled",
    0x17: "quick stop active",
    0x1F: "fault reaction active",
    0x08: "fault",
}
PHASES = ("armed", "streaming", "completing", "holding")
REASONS = ("Version", "Busy", "Closed", "Latched", "Period", "Meaningless", "Coarse", "Counts",
           "KeyWanted", "Keyless", "KeyOther")
SOFTWARE_STOP = 502

VERSION, DEPTH = 3, 16
TRANSLATION_NM, ROTATION_NRAD = 1_000, 10_000
HEARTBEAT_S = RETRY_S = 0.1
PATIENCE_S = 2.0

# The plan: from rest to rest in TICKS, along these counts: 20 mm and 100 mrad.
TICKS = 60
END = (-9_600, 7_200, 16_000, 3_600, -4_800, 8_000)
LIMITS = (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 0.5, 2.0, 40.0, 2.0, 10.0, 400.0)
START_LEVEL = 8
STOP_AT_TICK = 25


class Mismatch(Exception):
    """What is not as PROTOCOL.md says, in one sentence."""


def minimum_jerk(tick):
    """Six counts; T. Flash and N. Hogan, Journal of Neuroscience 5 (7), 1985."""
    s = tick / TICKS
    share = s**3 * (10 - 15 * s + 6 * s**2)
    return tuple(round(share * count) for count in END)


def fnv1a(data):
    """FNV-1a of 64 bits: the name of a plan."""
    value = 0xCBF29CE484222325
    for byte in data:
        value = (value ^ byte) * 0x100000001B3 % 2**64
    return value


def crc8(data):
    """CRC-8/AUTOSAR."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ (0x2F if crc & 0x80 else 0)) & 0xFF
    return crc ^ 0xFF


def siphash(secret, data):
    """SipHash-2-4 with 128 bits (J.-P. Aumasson and D. J. Bernstein, 2012)."""
    k0, k1 = struct.unpack("<QQ", secret)
    v = [k0 ^ 0x736F6D6570736575, k1 ^ 0x646F72616E646F6D ^ 0xEE, k0 ^ 0x6C7967656E657261, k1 ^ 0x7465646279746573]

    def turned(value, bits):
        return (value << bits | value >> 64 - bits) % 2**64

    def rounds(count):
        for _ in range(count):
            v[0] = (v[0] + v[1]) % 2**64
            v[2] = (v[2] + v[3]) % 2**64
            v[1], v[3] = turned(v[1], 13) ^ v[0], turned(v[3], 16) ^ v[2]
            v[0] = turned(v[0], 32)
            v[2] = (v[2] + v[1]) % 2**64
            v[0] = (v[0] + v[3]) % 2**64
            v[1], v[3] = turned(v[1], 17) ^ v[2], turned(v[3], 21) ^ v[0]
            v[2] = turned(v[2], 32)

    padded = data + bytes(-(len(data) + 1) % 8) + bytes([len(data) % 256])
    for (word,) in struct.iter_unpack("<Q", padded):
        v[3] ^= word
        rounds(2)
        v[0] ^= word
    halves = []
    for place, mark in ((2, 0xEE), (1, 0xDD)):
        v[place] ^= mark
        rounds(4)
        halves.append(v[0] ^ v[1] ^ v[2] ^ v[3])
    return struct.pack("<QQ", *halves)


def gray(number):
    return number ^ number >> 1


def sign_extended(value, bits):
    return (value + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)


def nearest(reference, low, bits):
    """The number with these low bits that is nearest to the reference."""
    return reference + sign_extended(low - reference, bits)


@dataclass(frozen=True)
class Session:
    """Number and seal, or neither; with a key, what tags are made with."""

    number: int = 0
    seal: int = 0
    secret: bytes | None = None

    def key(self):
        if self.number == 0:
            return (0, 0, 0)
        return tuple(struct.pack("<I", zlib.crc32(struct.pack("<HQ", self.number, self.seal)))[:3])

    def key_of(self, identifier):
        place = {SETPOINT_T: 0, ACTUAL_T: 0, SETPOINT_R: 1, ACTUAL_R: 1}.get(identifier, 2)
        return self.key()[place]

    def sum(self, identifier, tick, payload, counts=None):
        """The last byte of a classic frame; the counts in full, if it has the low halves of some."""
        tick %= 2**32
        if self.secret:
            return siphash(self.secret, struct.pack("<HI", identifier, tick) + (counts_in_full(counts) or payload))[0]
        if counts:
            unsent = struct.pack("<I", gray(tick >> 8))[:3]
            unsent += struct.pack("<3H", *(gray((count & 0xFFFFFFFF) >> 16) for count in counts))
        else:
            unsent = struct.pack("<H", gray(tick >> 16))
        return crc8(struct.pack("<HB", identifier, self.key_of(identifier)) + unsent + payload)

    def sealed(self, identifier, payload, count):
        """A frame with four bytes of checksum; the first of its kind has count 1."""
        if self.secret:
            return identifier, payload + siphash(self.secret, struct.pack("<HI", identifier, count) + payload)[:4]
        return identifier, payload + struct.pack("<I", zlib.crc32(struct.pack("<HQ", identifier, self.seal) + payload))

    @staticmethod
    def opened(number, digest, nonce, secret=None):
        return Session(number, fnv1a(struct.pack("<QI", digest, nonce)), secret)


def counts_in_full(counts):
    return struct.pack("<3i", *counts) if counts else b""


@dataclass(frozen=True)
class Proof:
    """What a client with a key knows of its request."""

    key: bytes
    nonce: int

    def of(self, kind, *what):
        """Tag of 16 bytes; the last half of the key is for sessions."""
        own = self.key[16:] if kind == 3 else self.key[:16]
        return siphash(own, struct.pack("<BQ", kind, self.nonce) + b"".join(what))

    def added_to(self, body):
        """OpenKeyed instead of Open."""
        return b"\x01" + body[1:] + varint(self.nonce) + self.of(1, body)[:8]


def following_number(number):
    return number % 0xFFFF + 1


NONE = Session()


# --- postcard ---


def varint(number):
    encoded = bytearray()
    while number >= 0x80:
        encoded.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes(encoded) + bytes([number])


class Fields:
    """What a postcard body says, field by field."""

    def __init__(self, body):
        self.rest = body

    def varint(self):
        value = shift = 0
        while True:
            byte, self.rest = self.rest[0], self.rest[1:]
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    def take(self, count):
        taken, self.rest = self.rest[:count], self.rest[count:]
        return taken

    def f64s(self, count):
        values = struct.unpack_from(f"<{count}d", self.rest)
        self.rest = self.rest[8 * count :]
        return values


def open_request(number, plan_hash, period_us, reset=0):
    numbers = (0, VERSION, number, plan_hash, period_us, TICKS, TRANSLATION_NM, ROTATION_NRAD)
    return b"".join(map(varint, numbers)) + struct.pack("<12d", *LIMITS) + varint(START_LEVEL) + varint(reset)


def segments(body):
    """The frames of a record."""
    record = struct.pack("<H", len(body)) + body
    record += struct.pack("<I", zlib.crc32(record))
    pieces = [record[at : at + 7] for at in range(0, len(record), 7)]
    last = len(pieces) - 1
    return [(TO_ARM, bytes([index | (0x80 if index == last else 0)]) + piece) for index, piece in enumerate(pieces)]


class Reassembly:
    """Segments, in any order, to bodies."""

    def __init__(self):
        self.kept, self.last = {}, None

    def handle(self, data):
        """The body, if the record is complete."""
        index, is_last = data[0] & 0x3F, data[0] & 0x80 != 0
        if self.kept.get(index, data) != data:
            self.kept, self.last = {}, None
        self.kept[index] = data
        self.last = index if is_last else self.last
        if self.last is None or len(self.kept) <= self.last:
            return None
        record = b"".join(self.kept[index][1:] for index in range(self.last + 1))
        self.kept, self.last = {}, None
        (length,), (crc,) = struct.unpack_from("<H", record), struct.unpack("<I", record[-4:])
        if length + 6 != len(record) or zlib.crc32(record[:-4]) != crc:
            raise Mismatch(f"a record of the arm has a wrong length or checksum: {record.hex()}")
        return record[2:-4]


# --- what the arm says ---


@dataclass
class Status:
    session: int
    state: str
    phase: str | None
    standstill: bool
    tick: int
    have: int
    counter: int
    at_s: float


@dataclass
class Heard:
    """The arm's words, by an end that has asked for a session, and is in it once it is opened."""

    #: Number and body of the request, without proof.
    asked: tuple = (0, b"")
    proof: Proof | None = None
    session: Session = NONE
    status: Status | None = None
    opened: bool = False
    refused: tuple | None = None
    anchor: tuple | None = None
    #: Tick and counts.
    actual: tuple = (0, (0,) * 6)
    #: Counts of each tick that was sent.
    sent: dict = field(default_factory=lambda: {0: (0,) * 6})
    #: Code and tick.
    fault: tuple | None = None
    lost: int = 0
    halves: dict = field(default_factory=dict)
    reassembly: Reassembly = field(default_factory=Reassembly)

    def handle(self, identifier, data):
        handlers = {
            FAULT: self.take_fault,
            STATUS: self.take_status,
            ACTUAL_T: self.take_half,
            ACTUAL_R: self.take_half,
            FROM_ARM: self.take_segment,
            ARM_HEARTBEAT: self.take_heartbeat,
        }
        if identifier not in handlers:
            raise Mismatch(f"identifier {identifier:#05x} is none of an arm's")
        if identifier != FROM_ARM and len(data) != 8:
            raise Mismatch(f"frame {identifier:#05x} has {len(data)} bytes instead of 8")
        handlers[identifier](identifier, data)

    def last_status(self, now):
        """For a person: what it was, and how old it is."""
        if not self.status:
            return "no status was heard meanwhile"
        return f"the last status, heard {now - self.status.at_s:.2f} s ago, is {self.status}"

    def check(self, session, identifier, tick, payload, crc, counts=None):
        if session.sum(identifier, tick, payload, counts) != crc:
            raise Mismatch(f"frame {identifier:#05x} with {payload.hex()} has a wrong checksum for tick {tick}")

    def is_foreign(self, of_session):
        """Of a session, while this end is in none: it cannot be checked."""
        return of_session and self.session == NONE

    def whose(self, of_session):
        return self.session if of_session else NONE

    def full_tick(self, session, low):
        """Nearest to the greater of the ticks of the last status and of the setpoints sent."""
        reference = max(*self.sent, 0, self.status.tick if self.status else 0)
        return low if session == NONE else nearest(reference, low, 16)

    def take_status(self, identifier, data):
        word, low, have, counter, crc = struct.unpack("<HHHBB", data)
        state, marks = STATES.get(word & 0x7F), word & 0x4100
        if state is None or word & 0x8A80 or marks not in (0, 0x4100):
            raise Mismatch(f"{word:#06x} is no statusword")
        if self.is_foreign(marks != 0):
            return
        session = self.whose(marks != 0)
        tick = self.full_tick(session, low)
        self.check(session, identifier, tick, data[:-1], crc)
        if session != self.session:
            return  # In a session, what is said of none counts for nothing.
        if self.status and not 0 < (counter - self.status.counter) % 256 < 128:
            return
        phase = PHASES[word >> 12 & 3] if state == "operation enabled" else None
        now = time.monotonic()
        self.status = Status(session.number, state, phase, word & 0x400 != 0, tick, have, counter, now)

    def take_fault(self, identifier, data):
        error, register, code, low, crc = struct.unpack("<HBHHB", data)
        if error not in (0xFF00, 0xFF03) or register != 0x81:
            raise Mismatch(f"{error:#06x}, {register:#04x} is no error code and register of a fault frame")
        if self.is_foreign(error == 0xFF03):
            return
        session = self.whose(error == 0xFF03)
        tick = self.full_tick(session, low)
        self.check(session, identifier, tick, data[:-1], crc)
        self.fault = (code, tick)

    def take_half(self, identifier, data):
        if self.is_foreign(True):
            return
        *low, low_tick, crc = struct.unpack("<HHHBB", data)
        latest = max(*self.sent, self.actual[0], self.status.tick if self.status else 0)
        tick = nearest(latest, low_tick, 8)
        sent = min(self.sent, key=lambda of: (abs(of - tick), of))
        last = self.actual[0]
        near = self.actual[1] if abs(tick - last) <= max(3, abs(tick - sent)) else self.sent[sent]
        begin = 0 if identifier == ACTUAL_T else 3
        counts = tuple(nearest(count, bits, 16) for count, bits in zip(near[begin : begin + 3], low))
        self.check(self.session, identifier, tick, data[:-1], crc, counts)
        self.halves[identifier] = (tick, counts)
        pair = [self.halves.get(of) for of in (ACTUAL_T, ACTUAL_R)]
        if all(pair) and pair[0][0] == pair[1][0]:
            self.actual = (tick, pair[0][1] + pair[1][1])
            self.halves = {}

    def take_heartbeat(self, identifier, data):
        state, number, lost, _, crc = struct.unpack("<BHHHB", data)
        if self.is_foreign(number != 0):
            return
        if state != 5 or number not in (0, self.session.number):
            raise Mismatch(f"the arm's heartbeat says state {state} and session {number:#06x}")
        self.check(self.whose(number != 0), identifier, 0, data[:-1], crc)
        self.lost = lost

    def take_segment(self, _, data):
        body = self.reassembly.handle(data)
        if body is None:
            return
        try:
            self.take_record(body)
        except (IndexError, struct.error):
            raise Mismatch(f"a record of the arm has another body than it should: {body.hex()}") from None

    def take_record(self, body):
        fields = Fields(body)
        variant, number = fields.varint(), fields.varint()
        if variant == (3 if self.proof else 0) and number == self.asked[0]:
            self.take_opened(number, fields.varint(), fields.varint(), fields.take(8) if self.proof else b"")
        elif variant == 1:
            reason = REASONS[fields.varint()]
            details = {"Latched": 3, "Version": 1}.get(reason, 0)
            self.refused = (number, reason, tuple(fields.varint() for _ in range(details)))
        elif variant == (4 if self.session.secret else 2) and number == self.session.number:
            self.anchor = fields.f64s(7)
            if self.session.secret:
                covered = struct.pack("<HI", FROM_ARM, 0) + b"\x02" + body[1:-8]
                expect(fields.take(8), siphash(self.session.secret, covered)[:8], "the tag of the anchor")
        else:
            raise Mismatch(f"the arm answers with record {variant} for session {number:#06x}")
        if fields.rest:
            raise Mismatch(f"record {variant} has {len(fields.rest)} bytes too many")

    def take_opened(self, number, nonce, digest, tag):
        expect(digest, fnv1a(self.asked[1]), "the digest of what was opened")
        secret = None
        if self.proof:
            agreed = struct.pack("<IHQ", nonce, number, digest)
            expect(tag, self.proof.of(2, agreed)[:8], "the tag of the answer")
            secret = self.proof.of(3, agreed)
        session = Session.opened(number, digest, nonce, secret)
        if 0 in session.key() or (self.opened and session != self.session):
            raise Mismatch(f"the arm opens session {number:#06x} with nonce {nonce:#010x}")
        if not self.opened:
            self.status = None
        self.session, self.opened = session, True


# --- the client ---


class Client:
    """One end of a bus; whatever is waited for, it goes on listening and sending its heartbeat."""

    def __init__(self, bus, period_us, plan_hash, key):
        self.bus, self.period_us, self.plan_hash, self.key = bus, period_us, plan_hash, key
        self.heard = Heard()
        #: How many controls and heartbeats were sent in the session.
        self.said = {CONTROL: 0, OWN_HEARTBEAT: 0}
        self.heartbeat_at_s = math.inf
        #: Tick to when it was sent last.
        self.sent_at_s = {}
        self.resent = 0
        self.resend_at_s = 0.0
        self.quickest_s = math.inf

    def send(self, *frames):
        for identifier, data in frames:
            self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False), timeout=0.1)

    def send_sealed(self, identifier, payload):
        self.said[identifier] += 1
        self.send(self.heard.session.sealed(identifier, payload, self.said[identifier]))

    def control(self, word):
        self.send_sealed(CONTROL, struct.pack("<HH", word, self.heard.session.number))

    def setpoint(self, tick):
        counts, session = minimum_jerk(tick), self.heard.session
        for identifier, half in ((SETPOINT_T, counts[:3]), (SETPOINT_R, counts[3:])):
            low = struct.pack("<3HB", *(count & 0xFFFF for count in half), tick & 0xFF)
            self.send((identifier, low + bytes([session.sum(identifier, tick, low, half)])))
        self.sent_at_s[tick] = time.monotonic()
        self.heard.sent[tick] = counts

    def listen(self, until_s):
        """Takes in what comes in time, and all that is there then.

        On a slow machine it takes longer to ask for a session than until it is time to ask again. Were one frame taken in
        each time, the arm would say more meanwhile than is ever heard, and its answer would wait behind that. Nor does this
        go on for longer than RETRY_S, for where the machine hardly keeps up, setpoints would wait behind reports.
        """
        message = self.bus.recv(max(0.0, min(until_s, self.heartbeat_at_s) - time.monotonic()))
        enough_at_s = time.monotonic() + RETRY_S
        while message is not None:
            if not message.is_error_frame:
                self.heard.handle(message.arbitration_id, bytes(message.data))
            self.beat()
            message = self.bus.recv(0.0) if time.monotonic() < enough_at_s else None
        self.beat()

    def beat(self):
        """Sends the heartbeat when it is time."""
        now = time.monotonic()
        if now >= self.heartbeat_at_s:
            self.heartbeat_at_s = now + HEARTBEAT_S
            number = self.heard.session.number
            self.send_sealed(OWN_HEARTBEAT, struct.pack("<BH", 5, number))

    def wait_for(self, what, condition, ask=lambda: None, patience_s=PATIENCE_S):
        """Asks, and asks again, until the condition holds."""
        ask_at_s = asked_s = time.monotonic()
        give_up_at_s = ask_at_s + patience_s
        while not condition(self.heard):
            now = time.monotonic()
            if now >= give_up_at_s:
                raise Mismatch(f"waited {patience_s} s for {what}; {self.heard.last_status(now)}")
            if now >= ask_at_s:
                ask()
                # From when all of it has left: the arm is to have that time for its answer.
                ask_at_s, asked_s = time.monotonic() + RETRY_S, now
            self.listen(min(ask_at_s, give_up_at_s))
        self.quickest_s = min(self.quickest_s, time.monotonic() - asked_s)

    @staticmethod
    def state(name, number):
        """A condition: the arm is in this state and this session."""
        return lambda heard: heard.status and (heard.status.state, heard.status.session) == (name, number)

    @staticmethod
    def refused(number):
        """A condition: this session is refused."""
        return lambda heard: heard.refused and heard.refused[0] == number

    def ask_to_open(self, number, reset=0):
        """Asks for a session until there is an answer: opened, or why not."""
        body = open_request(number, self.plan_hash, self.period_us, reset)
        self.heard = Heard((number, body), self.new_proof())
        self.said = dict.fromkeys(self.said, 0)
        request = segments(self.proven(body))

        refused = self.refused(number)

        def answered(heard):
            return heard.opened or refused(heard)

        self.wait_for("an answer to Open", answered, lambda: self.send(*request))
        return None if self.heard.opened else self.heard.refused[1:]

    def new_proof(self):
        """With a nonce that no other session has."""
        return Proof(self.key, secrets.randbits(64)) if self.key else None

    def proven(self, body):
        return self.heard.proof.added_to(body) if self.heard.proof else body

    def open(self, number, reset=0):
        refused = self.ask_to_open(number, reset)
        if refused:
            raise Mismatch(f"session {number:#06x} is refused: {refused}")
        self.heartbeat_at_s = time.monotonic()

    def enable(self):
        """Steps 2 to 5 of PROTOCOL.md; the anchor."""
        number = self.heard.session.number
        self.wait_for("a status of the session", lambda heard: heard.status and heard.status.session == number)
        self.walk("ready to switch on", SHUTDOWN, after="switch on disabled")
        self.walk("switched on", SWITCH_ON, after="ready to switch on")
        self.walk("operation enabled", ENABLE_OPERATION, after="switched on")
        self.wait_for("Anchored", lambda heard: heard.anchor, lambda: self.control(ENABLE_OPERATION))
        expect(self.heard.status.phase, "armed", "the phase after enabling")
        return self.heard.anchor

    def walk(self, name, word, after):
        """One step up; asked for only in the state before it, since a late repetition may lead back down."""

        def ask():
            if self.heard.status.state == after:
                self.control(word)

        self.wait_for(name, self.state(name, self.heard.session.number), ask)

    def stream(self, until, patience_s):
        """Sends setpoints as credit allows, and again those that are missing, until the condition holds."""
        give_up_at_s = time.monotonic() + patience_s
        following = 1
        self.sent_at_s = {}
        while not until(self.heard):
            status = self.heard.status
            if status.state != "operation enabled":
                raise Mismatch(f"the arm is in {status.state} at tick {status.tick}, with fault {self.heard.fault}")
            if time.monotonic() >= give_up_at_s:
                last = self.heard.last_status(time.monotonic())
                raise Mismatch(f"after {patience_s} s the arm has got no further; {last}")
            while following <= min(TICKS, status.tick + DEPTH):
                self.setpoint(following)
                following += 1
            self.resend_one(status)
            self.listen(time.monotonic() + self.period_us / 1e6)

    def resend_one(self, status):
        """The first setpoint that should be there by what the status says, and is not; one in each period."""
        period_s = self.period_us / 1e6
        had_to_be_sent_by_s = status.at_s - self.quickest_s - period_s / 2
        if time.monotonic() < self.resend_at_s:
            return
        for ahead in range(DEPTH):
            tick = status.tick + 1 + ahead
            missing = not status.have >> ahead & 1
            if missing and self.sent_at_s.get(tick, math.inf) <= had_to_be_sent_by_s:
                self.setpoint(tick)
                self.resent += 1
                self.resend_at_s = time.monotonic() + period_s
                return


def expect(found, expected, what):
    if found != expected:
        raise Mismatch(f"{what} is {found!r} instead of {expected!r}")


# --- poses ---


def product(a, b):
    """Of two quaternions w, x, y, z."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def displaced(pose, counts):
    """(p0 + T, exp(R) R0)."""
    translation = [count * TRANSLATION_NM * 1e-9 for count in counts[:3]]
    rotation = [count * ROTATION_NRAD * 1e-9 for count in counts[3:]]
    angle = math.hypot(*rotation)
    sine = math.sin(angle / 2) / angle if angle > 0 else 0.5
    turn = (math.cos(angle / 2), *(sine * component for component in rotation))
    return (*(p + t for p, t in zip(pose[:3], translation)), *product(turn, pose[3:]))


def check_anchor(anchor):
    norm = math.hypot(*anchor[3:])
    if not abs(norm - 1) <= 1e-9:
        raise Mismatch(f"the norm of the anchor's orientation is {norm} instead of 1")
    if not all(low <= x <= high for low, x, high in zip(LIMITS[:3], anchor[:3], LIMITS[3:6])):
        raise Mismatch(f"the anchor {anchor[:3]} lies outside the workspace of the session")


def check_same_pose(found, expected):
    """Within half a count of the wire."""
    off_m = math.dist(found[:3], expected[:3])
    # Whether q or -q: the same orientation.
    dot = abs(sum(a * b for a, b in zip(found[3:], expected[3:])))
    off_rad = 2 * math.acos(min(1.0, dot))
    if off_m > TRANSLATION_NM * 1e-9 / 2 or off_rad > ROTATION_NRAD * 1e-9 / 2:
        raise Mismatch(f"the second anchor is {off_m:.2e} m, {off_rad:.2e} rad from the end of the first motion")


# --- the two sessions ---


def play(client, number):
    """The whole plan, from Open to shutdown; the pose where it must have ended."""
    client.open(number)
    anchor = client.enable()
    check_anchor(anchor)
    print(f"Session {number:#06x}: anchored at {', '.join(f'{x:.4f}' for x in anchor[:3])} m.")

    def holds(heard):
        status = heard.status
        return status.phase == "holding" and status.standstill and heard.actual[0] == TICKS

    client.stream(holds, patience_s=PATIENCE_S + 2 * TICKS * client.period_us / 1e6)
    expect(client.heard.status.tick, TICKS, "the tick of the arm that holds")
    expect(client.heard.actual, (TICKS, END), "the actual displacement of the arm that holds")
    print(f"It holds the end's very counts; setpoints sent again: {client.resent}, lost: {client.heard.lost}.")
    closed = client.state("ready to switch on", number)
    client.wait_for("the session to be closed", closed, lambda: client.control(SHUTDOWN))
    expect(client.heard.status.standstill, True, "standstill when the session is closed")
    client.heartbeat_at_s = math.inf
    return displaced(anchor, END)


def check_keyless(client, number):
    """An arm with a key opens nothing for somebody without one.

    The number is this request's alone: a second answer, should it have been sent twice, must not pass for that to another.
    """
    key, client.key = client.key, None
    expect(client.ask_to_open(number), ("KeyWanted", ()), "the answer to Open without a key")
    client.key = key


def check_closed(client, number):
    """What is over is not opened again."""
    expect(client.ask_to_open(number), ("Closed", ()), "the answer to Open of a session that is over")


def stop_in_motion(client, number, start):
    """Begins the plan, stops it by the stop frame, resets it by the nonce of the arm."""
    client.open(number)
    client.heartbeat_at_s = time.monotonic()
    check_same_pose(client.enable(), start)
    client.stream(lambda heard: heard.status.tick >= STOP_AT_TICK, PATIENCE_S + TICKS * client.period_us / 1e6)
    expect(client.heard.fault, None, "the fault before the stop")
    expect(client.heard.status.standstill, False, "standstill in mid-motion")
    client.send((STOP, b"STOP"))
    stopping = client.state("quick stop active", number)
    client.wait_for("quick stop active", stopping)
    client.wait_for(
        "standstill, with a fault frame",
        lambda heard: stopping(heard) and heard.status.standstill and heard.fault,
    )
    expect(client.heard.fault[0], SOFTWARE_STOP, "the fault of a stop frame")
    reached, tick = client.heard.actual, client.heard.status.tick
    if not STOP_AT_TICK <= tick < TICKS:
        raise Mismatch(f"the arm was stopped at tick {tick}")
    print(f"Stopped by the stop frame at tick {tick}, {math.hypot(*reached[1][:3]) / 1e3:.2f} mm from the anchor.")
    number, nonce = check_latched(client, number, client.heard.fault)
    number = following_number(number)
    client.open(number, reset=nonce)
    client.wait_for("the reset", client.state("switch on disabled", number))
    client.heartbeat_at_s = math.inf


def check_latched(client, number, fault):
    """It stays latched, and no other session is opened: the last number asked for, and what it can be reset by."""
    client.heartbeat_at_s = math.inf
    still_at_s = time.monotonic() + 0.5
    client.wait_for("half a second", lambda heard: time.monotonic() >= still_at_s)
    expect(client.heard.status.state, "quick stop active", "the state half a second after the stop")
    for reset in (0, 1):
        # Each has a number of its own, by which the answers are told apart.
        number = following_number(number)
        body = open_request(number, client.plan_hash, client.period_us, reset)
        request = segments(client.proven(body))
        client.wait_for("a refusal", client.refused(number), lambda: client.send(*request))
        _, reason, (*found, nonce) = client.heard.refused
        expect((reason, tuple(found)), ("Latched", fault), "the answer to Open while a stop is latched")
    return number, nonce


def key_in(path):
    content = Path(path).read_bytes()
    return content if len(content) == 32 else bytes.fromhex(content.decode())


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("interface", help="SocketCAN interface, for instance vcan0")
    arguments.add_argument("--period-us", type=int, default=10_000, help="control period (default %(default)s)")
    arguments.add_argument("--key", type=key_in, help="file with the arm's key: 32 bytes, or 64 hexadecimal digits")
    arguments.add_argument("--session", type=int, default=random.randint(1, 0xFFFF), help="number (default: random)")
    arguments = arguments.parse_args()
    plan = b"".join(struct.pack("<6i", *minimum_jerk(tick)) for tick in range(1, TICKS + 1))
    number = arguments.session
    try:
        with can.Bus(interface="socketcan", channel=arguments.interface) as bus:
            client = Client(bus, arguments.period_us, fnv1a(plan), arguments.key)
            if client.key:
                check_keyless(client, number)
                number = following_number(number)
            end = play(client, number)
            check_closed(client, number)
            stop_in_motion(client, following_number(number), end)
    except Mismatch as mismatch:
        sentence = f"{mismatch}."
        sys.exit(sentence[0].upper() + sentence[1:])
    except (can.CanError, OSError) as error:
        sys.exit(f"The interface {arguments.interface} cannot be used: {error}.")
    print("The arm does what PROTOCOL.md says.")


if __name__ == "__main__":
    main()
