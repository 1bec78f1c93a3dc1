"""Runs programs in URScript, as far as the exported ones use it, on an arm that is where it is told to be.

What is not of this part of the language is an error, and so is what a controller would refuse: unknown names, lists of other
lengths, arguments out of range, a loop that takes no time. Variables are found as UR's manual says: `local` in the function,
`global` for all, others among the globals first and then in the function.
"""

import math
import re


TOKEN = re.compile(
    r"(?P<number>\d+\.\d+|\d+)|(?P<name>[A-Za-z_]\w*)|(?P<text>\"[^\"]*\")|(?P<sign><=|>=|==|!=|[-+*/<>=()\[\],:])|(?P<bad>\S)"
)
KEYWORDS = {"def", "end", "while", "if", "elif", "else", "return", "local", "global", "halt", "and", "or", "not", "True", "False"}

# A controller takes a loop for endless that does so much without waiting for the arm.
MOST_STATEMENTS_AT_ONCE = 10_000


class ScriptError(Exception):
    """Not a program, or one that a controller stops."""


class Halted(Exception):
    """The program's own `halt`."""


class Returned(Exception):
    def __init__(self, value):
        self.value = value


def lines_of(text):
    """Tokens of each line that has any, with its number."""
    for number, line in enumerate(text.splitlines(), 1):
        tokens = [(match.lastgroup, match.group()) for match in TOKEN.finditer(line.split("#")[0])]
        bad = [token for kind, token in tokens if kind == "bad"]
        if bad:
            raise ScriptError(f"line {number}: {bad[0]!r} is no URScript")
        if tokens:
            yield number, tokens


class Parser:
    """Statements are tuples: what it is, the line's number, its parts."""

    def __init__(self, text):
        self.lines = list(lines_of(text))
        self.line, self.at = 0, 0

    def error(self, why):
        number = self.lines[min(self.line, len(self.lines) - 1)][0]
        raise ScriptError(f"line {number}: {why}")

    def peek(self):
        if self.line >= len(self.lines):
            return ("end of file", "")
        tokens = self.lines[self.line][1]
        return tokens[self.at] if self.at < len(tokens) else ("end of line", "")

    def next(self):
        token = self.peek()
        self.at += 1
        return token

    def takes(self, text):
        if self.peek()[1] == text and self.peek()[0] in ("sign", "name"):
            self.at += 1
            return True
        return False

    def expect(self, text):
        if not self.takes(text):
            self.error(f"{self.peek()[1]!r} where {text!r} should be")

    def newline(self):
        if self.peek()[0] != "end of line":
            self.error(f"{self.peek()[1]!r} after the end of a statement")
        self.line, self.at = self.line + 1, 0

    def name(self):
        kind, text = self.next()
        if kind != "name" or text in KEYWORDS:
            self.error(f"{text!r} where a name should be")
        return text

    def program(self):
        body = []
        while self.line < len(self.lines):
            body.append(self.statement())
        return body

    def block(self, *ends):
        """Statements up to a line that begins with one of the words, which is not taken."""
        body = []
        while self.peek()[1] not in ends:
            if self.peek()[0] == "end of file":
                raise ScriptError("the file ends within a block")
            body.append(self.statement())
        return body

    def statement(self):
        number = self.lines[self.line][0]
        for word in ("def", "while", "if", "return", "halt", "local", "global"):
            if self.takes(word):
                return getattr(self, f"{word}_statement")(number)
        start = self.at
        if self.peek()[0] == "name":
            name = self.name()
            if self.takes("="):
                value = self.expression()
                self.newline()
                return ("assign", number, None, name, value)
        self.at = start
        value = self.expression()
        if value[0] != "call":
            self.error("a statement that does nothing")
        self.newline()
        return ("evaluate", number, value)

    def def_statement(self, number):
        name, parameters = self.name(), []
        self.expect("(")
        while not self.takes(")"):
            parameters.append(self.name())
            self.peek()[1] == ")" or self.expect(",")
        self.expect(":")
        self.newline()
        body = self.block("end")
        self.expect("end")
        self.newline()
        return ("def", number, name, parameters, body)

    def while_statement(self, number):
        condition = self.condition()
        body = self.block("end")
        self.expect("end")
        self.newline()
        return ("while", number, condition, body)

    def if_statement(self, number):
        branches = [(self.condition(), self.block("elif", "else", "end"))]
        while self.takes("elif"):
            branches.append((self.condition(), self.block("elif", "else", "end")))
        if self.takes("else"):
            self.expect(":")
            self.newline()
            branches.append((("value", True), self.block("end")))
        self.expect("end")
        self.newline()
        return ("if", number, branches)

    def condition(self):
        condition = self.expression()
        self.expect(":")
        self.newline()
        return condition

    def return_statement(self, number):
        value = self.expression()
        self.newline()
        return ("return", number, value)

    def halt_statement(self, number):
        self.newline()
        return ("halt", number)

    def local_statement(self, number, scope="local"):
        name = self.name()
        self.expect("=")
        value = self.expression()
        self.newline()
        return ("assign", number, scope, name, value)

    def global_statement(self, number):
        return self.local_statement(number, "global")

    LEVELS = [["or"], ["and"], ["==", "!=", "<", "<=", ">", ">="], ["+", "-"], ["*", "/"]]

    def expression(self, level=0):
        if level == len(self.LEVELS):
            return self.unary()
        left = self.expression(level + 1)
        while self.peek()[1] in self.LEVELS[level]:
            sign = self.next()[1]
            left = ("binary", sign, left, self.expression(level + 1))
        return left

    def unary(self):
        if self.takes("-"):
            return ("negated", self.unary())
        if self.takes("not"):
            return ("not", self.unary())
        value = self.primary()
        while self.takes("["):
            value = ("index", value, self.expression())
            self.expect("]")
        return value

    def primary(self):
        kind, text = self.next()
        if kind == "number":
            return ("value", float(text) if "." in text else int(text))
        if kind == "text":
            return ("value", text[1:-1])
        if text in ("True", "False"):
            return ("value", text == "True")
        if text == "(":
            value = self.expression()
            self.expect(")")
            return value
        if text == "[":
            return ("list", self.arguments("]")[0])
        if text == "p" and self.takes("["):
            values, named = self.arguments("]")
            if len(values) != 6 or named:
                self.error("a pose has six numbers")
            return ("list", values)
        if kind == "name" and text not in KEYWORDS:
            if self.takes("("):
                return ("call", text, *self.arguments(")"))
            return ("name", text)
        self.error(f"{text!r} where a value should be")

    def arguments(self, end):
        """Values, and values with names."""
        values, named = [], {}
        while not self.takes(end):
            value = self.expression()
            if value[0] == "name" and end == ")" and self.takes("="):
                named[value[1]] = self.expression()
            elif named:
                self.error("a value without a name after one with a name")
            else:
                values.append(value)
            self.peek()[1] == end or self.expect(",")
        return values, named


def numbers(value):
    return isinstance(value, list) and all(isinstance(part, (int, float)) and not isinstance(part, bool) for part in value)


def number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def combined(sign, a, b):
    """Arithmetic of numbers and lists of numbers."""
    one = {"+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a / b}[sign]
    if number(a) and number(b):
        return one(a, b)
    if numbers(a) and numbers(b) and len(a) == len(b) and sign in "+-":
        return [one(x, y) for x, y in zip(a, b)]
    if numbers(a) and number(b) and sign in "*/":
        return [one(x, b) for x in a]
    if number(a) and numbers(b) and sign == "*":
        return [one(a, y) for y in b]
    raise ScriptError(f"{a!r} {sign} {b!r}")


class Arm:
    """An arm (`ur.Arm`) that is where it is told to be, and a record of what it was told."""

    def __init__(self, made_as, joints=(0.1, -1.2, 1.4, -0.3, 1.2, 0.2), misses_by=0.0, size=1.0):
        self.made_as, self.joints, self.misses_by, self.size = made_as, list(joints), misses_by, size
        self.time_s, self.setpoints, self.moves, self.messages, self.stops = 0.0, [], [], [], []
        self.tcp, self.payload = None, None

    def check(self, q):
        if not numbers(q) or len(q) != 6 or not all(math.isfinite(x) and abs(x) <= 2 * math.pi for x in q):
            raise ScriptError(f"{q!r} are no joints")

    def movej(self, q, a=1.4, v=1.05):
        self.check(q)
        if not (0 < a <= 20 and 0 < v <= math.pi):
            raise ScriptError(f"movej with a={a}, v={v}")
        self.moves.append((list(q), a, v))
        self.joints = [x + self.misses_by for x in q]
        self.time_s += 1.0

    def servoj(self, q, a=0, v=0, t=0.002, lookahead_time=0.1, gain=300):
        self.check(q)
        if not 0.03 <= lookahead_time <= 0.2 or not 100 <= gain <= 2000 or t <= 0:
            raise ScriptError(f"servoj with t={t}, lookahead_time={lookahead_time}, gain={gain}")
        self.setpoints.append((t, list(q)))
        self.joints = [x + self.misses_by for x in q]
        self.time_s += t

    def stopj(self, a):
        if not 0 < a <= 40:
            raise ScriptError(f"stopj with a={a}")
        self.stops.append(a)
        self.time_s += 0.1

    def textmsg(self, text, value=""):
        # And after how many setpoints.
        self.messages.append((len(self.setpoints), f"{text}{value}"))

    def set_tcp(self, pose):
        if not numbers(pose) or len(pose) != 6:
            raise ScriptError(f"{pose!r} is no tool")
        self.tcp = pose

    def set_payload(self, mass, centre):
        if not (number(mass) and 0 <= mass <= 50 and numbers(centre) and len(centre) == 3):
            raise ScriptError(f"{mass!r} kg at {centre!r} is no payload")
        self.payload = (mass, centre)

    def get_actual_joint_positions(self):
        return list(self.joints)

    def get_forward_kin(self, q, tcp):
        self.check(q)
        if not numbers(tcp) or len(tcp) != 6 or any(tcp):
            raise ScriptError(f"{tcp!r} is a tool that is not looked at here")
        return [*(self.made_as.flange(q)[:3, 3] * self.size), 0.0, 0.0, 0.0]

    def norm(self, value):
        return abs(value) if number(value) else math.sqrt(sum(x * x for x in value))


BUILT_IN = {
    "movej", "servoj", "stopj", "textmsg", "set_tcp", "set_payload", "get_actual_joint_positions", "get_forward_kin", "norm"
}


class Program:
    def __init__(self, text):
        body = Parser(text).program()
        if [statement[0] for statement in body] != ["def"]:
            raise ScriptError("what a controller runs is one function")
        self.body = body

    def run(self, arm):
        """Whether it ran to its end; `halt` is none."""
        self.arm, self.globals, self.functions = arm, {}, {}
        self.at_once, self.at_once_s = 0, arm.time_s
        _, _, name, parameters, body = self.body[0]
        if parameters:
            raise ScriptError("the program has parameters")
        try:
            self.block(body, {})
        except Halted:
            return False
        return True

    def block(self, body, local):
        for statement in body:
            if self.arm.time_s != self.at_once_s:
                self.at_once, self.at_once_s = 0, self.arm.time_s
            self.at_once += 1
            if self.at_once > MOST_STATEMENTS_AT_ONCE:
                raise ScriptError(f"line {statement[1]}: an endless loop")
            self.statement(statement, local)

    def statement(self, statement, local):
        kind, line, *parts = statement
        try:
            if kind == "def":
                self.functions[parts[0]] = parts[1:]
            elif kind == "while":
                while self.truth(parts[0], local):
                    self.block(parts[1], local)
            elif kind == "if":
                chosen = next((body for condition, body in parts[0] if self.truth(condition, local)), [])
                self.block(chosen, local)
            elif kind == "return":
                raise Returned(self.value(parts[0], local))
            elif kind == "halt":
                raise Halted()
            elif kind == "evaluate":
                self.value(parts[0], local)
            else:
                self.assign(*parts, local)
        except ScriptError as error:
            raise error if str(error).startswith("line ") else ScriptError(f"line {line}: {error}")

    def assign(self, scope, name, value, local):
        value = self.value(value, local)
        if scope is None:
            known = local if name in local else self.globals if name in self.globals else local
        else:
            known = local if scope == "local" else self.globals
        before = known.get(name, value)
        if isinstance(before, list) != isinstance(value, list) or isinstance(value, list) and len(before) != len(value):
            raise ScriptError(f"{name} was {before!r} and cannot be {value!r}")
        known[name] = value

    def truth(self, condition, local):
        value = self.value(condition, local)
        if not isinstance(value, bool):
            raise ScriptError(f"{value!r} is neither True nor False")
        return value

    def value(self, expression, local):
        kind, *parts = expression
        if kind == "value":
            return parts[0]
        if kind == "list":
            return [self.value(part, local) for part in parts[0]]
        if kind == "name":
            for known in (local, self.globals):
                if parts[0] in known:
                    return known[parts[0]]
            raise ScriptError(f"{parts[0]} is not known")
        if kind == "index":
            values, at = (self.value(part, local) for part in parts)
            if not isinstance(values, list) or not isinstance(at, int) or not 0 <= at < len(values):
                raise ScriptError(f"{values!r}[{at!r}]")
            return values[at]
        if kind == "negated":
            return combined("*", -1, self.value(parts[0], local))
        if kind == "not":
            return not self.truth(parts[0], local)
        if kind == "call":
            return self.call(*parts, local)
        return self.binary(*parts, local)

    def binary(self, sign, left, right, local):
        if sign in ("and", "or"):
            first = self.truth(left, local)
            return first if first == (sign == "or") else self.truth(right, local)
        a, b = self.value(left, local), self.value(right, local)
        if sign in "+-*/":
            return combined(sign, a, b)
        if not (number(a) and number(b)):
            raise ScriptError(f"{a!r} {sign} {b!r}")
        return {"==": a == b, "!=": a != b, "<": a < b, "<=": a <= b, ">": a > b, ">=": a >= b}[sign]

    def call(self, name, values, named, local):
        values = [self.value(value, local) for value in values]
        named = {key: self.value(value, local) for key, value in named.items()}
        if name in self.functions:
            parameters, body = self.functions[name]
            if named or len(values) != len(parameters):
                raise ScriptError(f"{name} takes {len(parameters)} values")
            try:
                self.block(body, dict(zip(parameters, values)))
            except Returned as returned:
                return returned.value
            return None
        if name not in BUILT_IN:
            raise ScriptError(f"there is no function {name}")
        try:
            return getattr(self.arm, name)(*values, **named)
        except TypeError as error:
            raise ScriptError(f"{name}: {error}")
