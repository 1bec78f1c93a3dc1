"""Opens reports in headless Chromium and checks what a reader would see: pages.py [--made-up] SCREENSHOTS REPORT...

For each report: it asks for nothing but itself, says nothing in the console, fits screens of 400 to 1400 pixels,
lets fingers do what a mouse does, draws every chart, with marks of the axes exactly where their numbers say, and reads
values out; a replay is not blank, plays, stops, is at the right frame after scrubbing and stepping, changes with colours,
layers and points of view, and names its containers; without WebGL there is a sentence in its place. With --made-up, the
first report is the package's example, whose particle 0 is where a formula says.
"""

import base64
import contextlib
import itertools
import json
import math
import pathlib
import sys
import tempfile
import time

from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

FLAGS = [
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--hide-scrollbars",
]
WITH_WEBGL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WITHOUT_WEBGL = ["--disable-3d-apis"]
PATIENCE_S = 120
WIDTHS = [400, 600, 800, 1400]

# What reaches beyond the screen and cannot be scrolled to in a box of its own.
CUT_OFF = """
const scrolls = (element) => element && (/auto|scroll/.test(getComputedStyle(element).overflowX) || scrolls(element.parentElement));
return [...document.querySelectorAll('body *')].filter((element) => {
  const { left, right, width } = element.getBoundingClientRect();
  return width > 0 && (left < -0.5 || right > innerWidth + 0.5) && !scrolls(element) && !element.closest('.tip, #names, [hidden]');
}).map((element) => `${element.tagName} ${element.id} ${element.className}`);
"""

# Numbers of an axis that reach beyond their chart, which does not show what is outside of it.
CUT_NUMBERS = """
return [...arguments[0].querySelectorAll('.tick')].filter((tick) => {
  const [number, chart] = [tick, tick.ownerSVGElement].map((element) => element.getBoundingClientRect());
  return number.left < chart.left - 0.5 || number.right > chart.right + 0.5;
}).map((tick) => tick.textContent);
"""

# Texts of a chart that overlap: numbers at its axes, labels of marks, what its legend says.
ON_EACH_OTHER = """
return [...document.querySelectorAll('.chart')].flatMap((chart) => {
  const texts = [...chart.querySelectorAll('.plot text, .keys > *, h2, .unit')].map((element) => [element, element.getBoundingClientRect()]);
  return texts.flatMap(([one, a], i) => texts.slice(i + 1).filter(([, b]) => a.left < b.right - 1 && b.left < a.right - 1
    && a.top < b.bottom - 3 && b.top < a.bottom - 3).map(([other]) => `${one.textContent} / ${other.textContent}`));
});
"""

# Tables of which a part has to be scrolled to.
SCROLLED = """
return [...document.querySelectorAll('.table')].filter((table) => table.scrollWidth > table.clientWidth)
  .map((table) => table.getAttribute('aria-label'));
"""

# Tables of many columns of which no row has two numbers side by side, or a row begins at the very edge.
STACKED = """
const at = (element) => element.getBoundingClientRect();
return [...document.querySelectorAll('.table.wide')].filter((table) => {
  const rows = [...table.querySelectorAll('tbody tr')].map((row) => [...row.querySelectorAll('[data-name]')]);
  const isWrapped = (cells) => new Set(cells.map((cell) => Math.round(at(cell).top))).size < cells.length;
  return !rows.some(isWrapped) || rows.some(([first]) => at(first).left < at(table).left + 8);
}).map((table) => table.getAttribute('aria-label'));
"""

# Controls less than 40 pixels high or 28 wide.
SMALL = """
return [...document.querySelectorAll('button, select, label, input[type=range], summary')].filter((element) => {
  const { width, height } = element.getBoundingClientRect();
  const inLabel = element.closest('label') && element.tagName !== 'LABEL';
  return !inLabel && width > 0 && (height < 40 || width < 28);
}).map((element) => `${element.tagName} ${element.id} ${element.textContent.trim()}`);
"""

# Colours in bytes: what the shader gives the powder, and the containers' style.
COLOURS = """
const bytes = (colour) => {
  const context = Object.assign(document.createElement('canvas'), { width: 1, height: 1 }).getContext('2d');
  context.fillStyle = colour;
  context.fillRect(0, 0, 1, 1);
  return [...context.getImageData(0, 0, 1, 1).data].slice(0, 3);
};
const style = getComputedStyle(document.documentElement);
return {
  powder: globalThis.powderline.stage.powderColours.map(bytes),
  containers: ['--source', '--target', '--bystander', '--gate'].map((name) => bytes(style.getPropertyValue(name))),
};
"""

# In one task with the drawing, for the picture is gone afterwards.
PIXELS = """
const { stage } = globalThis.powderline;
stage.draw();
const gl = stage.canvas.getContext('webgl2');
const [width, height] = [gl.drawingBufferWidth, gl.drawingBufferHeight];
const pixels = new Uint8Array(4 * width * height);
gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
const tints = new Set();
let [sum, squares, hash] = [0, 0, 0];
for (let i = 0; i < pixels.length; i += 4) {
  const light = pixels[i] + pixels[i + 1] + pixels[i + 2];
  sum += light;
  squares += light * light;
  hash = (Math.imul(hash, 31) + (pixels[i] << 16) + (pixels[i + 1] << 8) + pixels[i + 2]) | 0;
  tints.add((pixels[i] >> 3 << 10) + (pixels[i + 1] >> 3 << 5) + (pixels[i + 2] >> 3));
}
const count = pixels.length / 4;
return { deviation: Math.sqrt(Math.max(squares / count - (sum / count) ** 2, 0)), tints: tints.size, hash };
"""


def number(text):
    """A number as an axis bears it."""
    return float(text.replace(",", "").replace("\u2212", "-"))


def colour_of(chart, series):
    """Which of the six colours a curve has."""
    return (chart["series"].index(series) if series["colour"] is None else series["colour"]) % 6


def first_stretch(points):
    """The points before the first gap, but for one at the beginning."""
    from_first = itertools.dropwhile(lambda point: None in point, points)
    return list(itertools.takewhile(lambda point: None not in point, from_first))


@contextlib.contextmanager
def chromium(flags):
    options = webdriver.ChromeOptions()
    options.binary_location = "/usr/bin/chromium"
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        for flag in [*FLAGS, *flags, f"--user-data-dir={profile}", "--window-size=1280,1400"]:
            options.add_argument(flag)
        service = webdriver.ChromeService("/usr/bin/chromedriver")
        driver = webdriver.Chrome(options, service)
        driver.set_script_timeout(PATIENCE_S)
        try:
            yield driver
        finally:
            driver.quit()


def check(holds, what):
    if not holds:
        raise AssertionError(what)


def until(condition, what):
    """Waits, as long as it takes a slow machine, for something that will be so."""
    ends = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        check(time.monotonic() < ends, f"never happened: {what}")
        time.sleep(0.05)
    return value


class Report:
    """A report in a browser."""

    def __init__(self, driver, path, shots):
        self.driver, self.path, self.shots = driver, path.resolve(), shots
        self.name = path.stem
        driver.get(self.path.as_uri())
        self.has_replay = bool(driver.find_elements(By.ID, "replay"))

    def script(self, text, *arguments):
        return self.driver.execute_script(text, *arguments)

    def find(self, selector):
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def find_all(self, selector):
        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def emulate(self, width, height, theme):
        feature = {"name": "prefers-color-scheme", "value": theme}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        self.settle()

    def settle(self):
        """Lets the browser lay out and draw."""
        self.driver.execute_async_script(
            "const done = arguments[0];"
            "requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 0)));")

    def screenshot(self, name):
        """All of the page, however long."""
        height = self.script("return document.documentElement.scrollHeight")
        width = self.script("return innerWidth")
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        options = {"format": "png", "captureBeyondViewport": True, "clip": clip}
        data = self.driver.execute_cdp_cmd("Page.captureScreenshot", options)["data"]
        (self.shots / f"{self.name}-{name}.png").write_bytes(base64.b64decode(data))

    def check_quiet(self):
        """No request but for the file, nothing in the console."""
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                url, document = message["params"]["request"]["url"], message["params"]["documentURL"]
                # The browser's own first page, with frames and requests of its own, from before it was sent to the report.
                if document.startswith(("chrome:", "chrome-untrusted:")):
                    continue
                own = url == self.path.as_uri() or url.startswith(("blob:", "data:"))
                check(own, f"{document} asked for {url}")
        entries = [entry for entry in self.driver.get_log("browser") if entry["level"] != "INFO"]
        # Pixels are read by this test, not by the page.
        loud = [entry["message"] for entry in entries if "stall due to ReadPixels" not in entry["message"]]
        check(not loud, f"the console says {loud}")

    def check_widths(self):
        """Nothing is wider than the page, whatever the screen, and fingers find every control."""
        for width in WIDTHS:
            self.emulate(width, 900, "light")
            wide = self.script("return document.documentElement.scrollWidth")
            check(wide <= width, f"at {width} pixels the page is {wide} wide")
            out = self.script(CUT_OFF)
            check(not out, f"at {width} pixels there is something cut off: {out}")
            scrolled = self.script(SCROLLED)
            check(not scrolled, f"at {width} pixels these tables do not show everything: {scrolled}")
            stacked = self.script(STACKED)
            check(not stacked, f"at {width} pixels these tables are lists of numbers: {stacked}")
            self.check_axes()
            self.check_labels()
        self.emulate(400, 900, "light")
        small = self.script(SMALL)
        check(not small, f"at 400 pixels there are controls too small for fingers: {small}")

    def check_axes(self):
        """Numbers at an axis stand where they say: in a straight line, or one of logarithms, through the curve's ends."""
        data = self.script("return JSON.parse(document.getElementById('charts-data')?.textContent ?? '[]')")
        for figure, chart in zip(self.find_all(".chart"), data):
            cut = self.script(CUT_NUMBERS, figure)
            check(not cut, f"{chart['title']}: numbers are cut off: {cut}")
            is_log = "logarithmic" in figure.find_element(By.CSS_SELECTOR, ".unit").text
            line = next(((series, points) for series in chart["series"]
                         if len(points := first_stretch(series["points"])) > 1), None)
            # A run of one epoch may have given single points only.
            if line is None:
                continue
            series, points = line
            colour = "reference" if series["reference"] else f"c{colour_of(chart, series)}"
            drawn = figure.find_element(By.CSS_SELECTOR, f".curve.{colour}").get_attribute("d")
            ends = [[float(part) for part in end.split(",")] for end in drawn.strip("M").split("L")]
            for axis, place, part in [("along", "x", 0), ("up", "y", 1)]:
                marks = [(float(text), number(words)) for text, words in self.script(
                    "return [...arguments[0].querySelectorAll('.tick.' + arguments[1])]"
                    ".map((tick) => [tick.getAttribute(arguments[2]), tick.textContent]);", figure, axis, place)]
                what = f"{chart['title']}, {axis}"
                check(len(marks) >= 2, f"{what}: only {len(marks)} numbers")
                # A number stands a little below its line.
                lower = 4 if axis == "up" else 0
                straight = math.log10 if is_log and axis == "up" else float
                known = [(ends[0][part], points[0][part]), (ends[-1][part], points[-1][part])]
                (start, low), (end, high) = [(at - lower, straight(value)) for at, value in (marks[0], marks[-1])]
                for at, value in [*known, *((at - lower, value) for at, value in marks)]:
                    expected = start + (end - start) * (straight(value) - low) / (high - low)
                    check(abs(at - expected) < 0.6, f"{what}: {value} is at {at}, not at {expected}")
                if axis == "along" and chart["x_label"] == "epoch":
                    check(all(value == int(value) for _, value in marks), f"{what}: epochs {marks}")

    def check_labels(self):
        """No two texts of a chart lie on each other."""
        hit = self.script(ON_EACH_OTHER)
        check(not hit, f"texts lie on each other: {hit}")

    def check_marks(self, figure, chart):
        """Every mark has its sign on every curve, its word in the legend, and its reason where one points."""
        points = {kind: 0 for kind in ["chosen", "passed-over"]}
        for x, mark in chart["marks"]:
            for series in (series for series in chart["series"] if not series["reference"]):
                points[mark["kind"]] += sum(at == x and y is not None for at, y in series["points"])
        for kind, count in points.items():
            signs = figure.find_elements(By.CSS_SELECTOR, f".sign.{kind}")
            check(len(signs) == count, f"{len(signs)} of {count} signs {kind} in {chart['title']}")
        legend = self.script("return arguments[0].querySelector('.keys')?.textContent ?? ''", figure)
        for x, mark in chart["marks"]:
            check(mark["label"] in legend, f"no {mark['label']} in the legend of {chart['title']}")
            self.read_out_at(figure, chart, x)
            tip = figure.find_element(By.CSS_SELECTOR, ".tip").text
            check(mark["label"] in tip and mark["note"] in tip, f"{mark} is not told at {x}: {tip}")
        if chart["shade"]:
            check(chart["shade"]["label"] in legend, f"no {chart['shade']['label']} in the legend")
            check(figure.find_elements(By.CSS_SELECTOR, ".shade"), f"nothing shaded in {chart['title']}")

    def read_out_at(self, figure, chart, x):
        """Points at a place with the arrow keys."""
        xs = sorted({at for series in chart["series"] for at, _ in series["points"] if at is not None})
        picture = figure.find_element(By.CSS_SELECTOR, ".plot svg")
        picture.send_keys(Keys.ESCAPE)
        picture.send_keys(*[Keys.ARROW_RIGHT] * (xs.index(x) + 1))

    def check_charts(self):
        data = self.script("return JSON.parse(document.getElementById('charts-data')?.textContent ?? '[]')")
        figures = self.find_all(".chart")
        check(len(figures) == len(data), f"{len(figures)} charts drawn, {len(data)} given")
        for figure, chart in zip(figures, data):
            check(figure.find_element(By.TAG_NAME, "h2").text.strip() == chart["title"].strip(), "a chart's title")
            marks = figure.find_elements(By.CSS_SELECTOR, ".curve, .dot")
            drawn = {mark.get_attribute("class").split()[1] for mark in marks}
            known = {"reference" if series["reference"] else f"c{colour_of(chart, series)}" for series in chart["series"]
                     if any(None not in point for point in series["points"])}
            check(drawn == known, f"curves {drawn} of {known} in {chart['title']}")
            if known:
                self.check_readout(figure, chart)
                self.check_marks(figure, chart)

    def check_readout(self, figure, chart):
        picture = figure.find_element(By.CSS_SELECTOR, ".plot svg")
        self.script("arguments[0].scrollIntoView({block: 'center'})", picture)
        ActionChains(self.driver).move_to_element(picture).perform()
        tip = figure.find_element(By.CSS_SELECTOR, ".tip")
        check(tip.is_displayed() and chart["x_label"].strip() in tip.text, f"nothing read out in {chart['title']}")
        at_mouse = tip.text
        picture.send_keys(Keys.ARROW_RIGHT)
        points = max(len(series["points"]) for series in chart["series"])
        check(points < 4 or tip.text != at_mouse, f"arrows read nothing out in {chart['title']}")

    # ---- Replay ----

    def open_replay(self):
        def ready():
            trouble = self.find("#replay-trouble")
            check(not trouble.is_displayed(), f"no replay: {trouble.text}")
            return self.script("return Boolean(globalThis.powderline)")
        until(ready, "the replay is unpacked")
        self.settle()

    def pixels(self):
        return self.script(PIXELS)

    def time_s(self):
        return self.script("return powderline.clock.time")

    def frame(self):
        return int(self.find("#stage canvas").get_attribute("data-frame"))

    def scrub(self, time_s):
        self.script("const s = document.getElementById('scrub'); s.value = arguments[0];"
                    "s.dispatchEvent(new Event('input', { bubbles: true }));", time_s)
        self.settle()

    def click(self, selector):
        self.script("arguments[0].scrollIntoView({block: 'center'})", self.find(selector))
        self.find(selector).click()
        self.settle()

    def check_replay(self):
        self.open_replay()
        first = self.pixels()
        check(first["deviation"] > 5 and first["tints"] > 50, f"the picture is blank: {first}")
        self.check_frames()
        self.check_playing()
        self.check_keys()
        self.check_settings()
        self.check_colours()
        self.check_views()

    def check_frames(self):
        """After scrubbing, the frame is the nearest, the clock says so, and picture and tool are elsewhere."""
        times = self.script("return powderline.replay.about.times_s")
        pictures = {}
        for share in [0, 0.31, 0.5, 0.77, 1]:
            time_s = round(times[0] + share * (times[-1] - times[0]), 3)
            self.scrub(time_s)
            nearest = min(abs(t - self.time_s()) for t in times)
            shown = abs(times[self.frame()] - self.time_s())
            check(abs(self.time_s() - time_s) < 2e-3, f"scrubbed to {time_s} s, is at {self.time_s()} s")
            check(abs(shown - nearest) < 1e-9, f"at {time_s} s the frame {self.frame()} is shown")
            check(self.find("#clock").text.startswith(f"{self.time_s():.2f} s"), self.find("#clock").text)
            pictures[self.frame()] = self.pixels()["hash"]
        check(len(set(pictures.values())) >= min(len(times), 3), "pictures of different times are alike")
        self.check_tool(times)
        self.check_gates(times)
        self.check_arm(times)

    def check_tool(self, times):
        """The tool is where its pose says, and between two frames between them."""
        poses = self.script("return powderline.replay.about.poses")
        middle = len(times) // 2
        self.script("powderline.clock.set(arguments[0])", times[middle])
        self.settle()
        drawn = self.script("return powderline.stage.layers.tool.position.toArray()")
        check(math.dist(drawn, poses[middle][:3]) < 1e-6, f"the tool is at {drawn}")

    def check_arm(self, times):
        """The arm's rods are where the page's frames have them; its column stands still."""
        if not self.script("return Boolean(powderline.replay.about.arm)"):
            return
        still = self.script("return powderline.replay.about.arm.standing_m.length / 6")
        for frame in [0, len(times) // 3, len(times) - 1]:
            self.script("powderline.clock.set(arguments[0])", times[frame])
            self.settle()
            told = self.script("const { arm } = powderline.replay.about;"
                               "return [...arm.standing_m, ...arm.moving_m[arguments[0]]];", frame)
            drawn = self.script("return powderline.stage.layers.arm.children[0].children.map((rod) => rod.position.toArray())")
            check(len(drawn) == still + 6 and len(told) == 6 * len(drawn), f"{len(drawn)} rods are drawn")
            for k, place in enumerate(drawn):
                ends = told[6 * k:6 * k + 6]
                middle = [0.5 * (a + b) for a, b in zip(ends[:3], ends[3:])]
                check(math.dist(place, middle) < 1e-6, f"at {times[frame]} s rod {k} is at {place}, not at {middle}")

    def check_gates(self, times):
        """Every gate is where the page's frames have it, and is not drawn where it is no longer there."""
        for frame in range(0, len(times), max(1, len(times) // 12)):
            self.script("powderline.clock.set(arguments[0])", times[frame])
            self.settle()
            told = self.script("return powderline.replay.about.gates.map((gate) => gate.moved_m[arguments[0]])", frame)
            drawn = self.script("return powderline.stage.layers.gate.children.map((gate) => gate.visible"
                                " ? gate.position.toArray() : null)")
            check(len(drawn) == len(told), f"{len(drawn)} of {len(told)} gates are drawn")
            for there, wanted in zip(drawn, told):
                same = math.dist(there, wanted) < 1e-6 if there and wanted else there == wanted
                check(same, f"at {times[frame]} s a gate is at {there}, not at {wanted}")

    def check_playing(self):
        self.scrub(0)
        before = self.pixels()
        # Slowly, for a slow machine is not to be at the end before it is stopped.
        self.choose_rate("0.1")
        drawn = self.drawn()
        self.click("#play")
        began = time.monotonic()
        check(self.find("#play").get_attribute("aria-label") == "Pause", "the button does not offer to pause")
        until(lambda: self.time_s() > 0.05 * self.end_s() or self.drawn() > drawn + 50, "time goes on")
        self.rate = (self.drawn() - drawn) / (time.monotonic() - began)
        self.click("#play")
        stopped = self.time_s()
        check(stopped > 0, "time did not go on")
        check(self.pixels()["hash"] != before["hash"], "nothing moved")
        self.settle()
        check(abs(self.time_s() - stopped) < 1e-12, "time goes on though paused")
        self.choose_rate("4")
        self.scrub(0.9 * self.end_s())
        self.click("#play")
        until(lambda: not self.script("return powderline.clock.playing"), "it ends")
        check(abs(self.time_s() - self.end_s()) < 1e-9, "it ended before the end")

    def choose_rate(self, rate):
        self.script("const r = document.getElementById('rate'); r.value = arguments[0];"
                    "r.dispatchEvent(new Event('change'));", rate)

    def drawn(self):
        return int(self.find("#stage canvas").get_attribute("data-drawn"))

    def end_s(self):
        return self.script("return powderline.replay.about.times_s.at(-1)")

    def check_keys(self):
        stage = self.find("#stage")
        self.scrub(0)
        last = self.script("return powderline.replay.frames.length - 1")
        for keys, frame in [([Keys.ARROW_RIGHT], 1), ([Keys.ARROW_RIGHT], 2), ([Keys.ARROW_LEFT], 1),
                            ([Keys.END], last), ([Keys.HOME], 0)]:
            stage.send_keys(*keys)
            self.settle()
            check(self.frame() == min(frame, last), f"{keys} led to frame {self.frame()} instead of {frame}")
        # Slowly, for it is not to be at the end before it is paused.
        self.choose_rate("0.1")
        stage.send_keys(Keys.SPACE)
        check(self.script("return powderline.clock.playing"), "space does not play")
        stage.send_keys(Keys.SPACE)
        check(not self.script("return powderline.clock.playing"), "space does not pause")

    def check_settings(self):
        self.scrub(0.6 * self.end_s())
        seen = set()
        modes = self.find_all("#colours input")
        for mode in modes:
            self.click(f"#colours input[value={mode.get_attribute('value')}]")
            check(self.find("#legend").text.strip(), "a colour without a legend")
            seen.add(self.pixels()["hash"])
        check(len(seen) == len(modes), "colours do not change the picture")
        self.click("#colours input[value=speed]")
        for box in self.find_all("#layers input"):
            layer = box.get_attribute("data-layer")
            if layer == "names":
                continue
            shown = self.pixels()["hash"]
            self.click(f"[data-layer={layer}]")
            check(self.pixels()["hash"] != shown, f"without {layer} the picture is the same")
            self.click(f"[data-layer={layer}]")
            check(self.pixels()["hash"] == shown, f"with {layer} again the picture is another")

    def check_names(self):
        """Every container has its name in the picture, until names are not wanted."""
        given = self.script("return powderline.replay.about.containers")
        told = self.script("return [...document.querySelectorAll('#names span')].map((name) => name.textContent)")
        check(len(told) == len(given), f"{told} for {given}")
        keys = self.find("#layers").text
        for container, name in zip(given, told):
            check(container["name"] in name and container["name"].lower() in keys.lower(), f"{name} for {container}")
        stage = self.find("#stage").rect
        boxes = [name.rect for name in self.find_all("#names span") if name.is_displayed()]
        check(len(boxes) == len(given), f"only {len(boxes)} of {len(given)} names are shown")
        for box in boxes:
            inside = (stage["x"] <= box["x"] and box["x"] + box["width"] <= stage["x"] + stage["width"]
                      and stage["y"] <= box["y"] and box["y"] + box["height"] <= stage["y"] + stage["height"])
            check(inside, f"a name lies at {box}, outside of {stage}")
        told = [other.rect for other in self.find_all("#stage .views, #stage .scale")]
        for one in boxes:
            for other in boxes + told:
                apart = (one is other or one["x"] + one["width"] <= other["x"] or other["x"] + other["width"] <= one["x"]
                         or one["y"] + one["height"] <= other["y"] or other["y"] + other["height"] <= one["y"])
                check(apart, f"names lie on each other: {one}, {other}")
        self.click("[data-layer=names]")
        check(not self.find("#names").is_displayed(), "names are still there")
        self.click("[data-layer=names]")
        check(self.find("#names").is_displayed(), "names do not come back")

    def touch(self, kind, *points):
        at = [{"x": x, "y": y} for x, y in points]
        self.driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})

    def middle(self, selector):
        """Where the middle of something is on the screen, scrolled to."""
        self.script("arguments[0].scrollIntoView({block: 'center'})", self.find(selector))
        return self.script("const { x, y, width, height } = arguments[0].getBoundingClientRect();"
                           "return [x + width / 2, y + height / 2];", self.find(selector))

    def check_touch(self):
        """A finger reads a chart, ticks a box, and turns the picture."""
        self.emulate(400, 900, "light")
        self.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
        if self.find_all(".chart"):
            self.touch("touchStart", self.middle(".chart .plot svg"))
            self.touch("touchEnd")
            self.settle()
            check(self.find(".chart .tip").is_displayed(), "a chart that is touched tells nothing")
        if self.has_replay:
            shown = self.pixels()["hash"]
            self.touch("touchStart", self.middle("#layers label"))
            self.touch("touchEnd")
            until(lambda: self.pixels()["hash"] != shown, "a finger ticks a box")
            self.click("#layers input")
            shown = self.pixels()["hash"]
            x, y = self.middle("#stage")
            self.touch("touchStart", (x, y))
            for step in range(1, 9):
                self.touch("touchMove", (x + 8 * step, y))
            self.touch("touchEnd")
            self.settle()
            check(self.pixels()["hash"] != shown, "a finger does not turn the picture")
            self.click("[data-view=oblique]")
        self.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})

    def check_colours(self):
        """No colour that powder may have is that of a container."""
        told = self.script(COLOURS)
        for powder in told["powder"]:
            for container in told["containers"]:
                apart = math.dist(powder, container)
                check(apart > 60, f"powder may be {powder}, a container is {container}")

    def check_views(self):
        seen = set()
        for button in self.find_all("[data-view]"):
            self.click(f"[data-view={button.get_attribute('data-view')}]")
            seen.add(self.pixels()["hash"])
            self.check_names()
        check(len(seen) == 4, "points of view are alike")
        self.click("[data-view=oblique]")
        still = self.pixels()["hash"]
        canvas = self.find("#stage canvas")
        ActionChains(self.driver).drag_and_drop_by_offset(canvas, 60, 20).perform()
        self.settle()
        check(self.pixels()["hash"] != still, "dragging does not orbit")
        self.click("[data-view=oblique]")

    def check_particle(self):
        """Particle 0 of the made-up page lies in the bowl while it is carried: there the page must show it."""
        times = self.script("return powderline.replay.about.times_s")
        poses = self.script("return powderline.replay.about.poses")
        size_m = self.script("return powderline.replay.about.size_m")
        for frame in [k for k, t in enumerate(times) if 1.3 < t < 3.9]:
            place = self.script("return powderline.replay.position(arguments[0], 0)", frame)
            x, y, z, i, j, k, w = poses[frame]
            # 30 mm along the tool's -z.
            down = [2 * (i * k + w * j), 2 * (j * k - w * i), 1 - 2 * (i * i + j * j)]
            truth = [p - 0.03 * d for p, d in zip([x, y, z], down)]
            for axis in range(3):
                off_m = abs(place[axis] - truth[axis])
                check(off_m < 0.5 * size_m[axis] / 65535 + 3e-6, f"particle 0 is {off_m} m off in frame {frame}")

    def take_screenshots(self):
        for width, theme in [*((width, "light") for width in WIDTHS), (1400, "dark")]:
            self.emulate(width, 900, theme)
            if self.has_replay:
                self.scrub(0.63 * self.end_s())
            self.screenshot(f"{width}-{theme}")
        if self.has_replay:
            self.emulate(1400, 900, "light")
            for view, mode, share in [("front", "height", 0.5), ("top", "destination", 0.85), ("side", "speed", 1)]:
                self.click(f"[data-view={view}]")
                for button in self.find_all(f"#colours input[value={mode}]"):
                    button.click()
                self.scrub(share * self.end_s())
                self.find("#stage").screenshot(str(self.shots / f"{self.name}-{view}.png"))
            self.click("[data-view=oblique]")
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        pdf = self.driver.execute_cdp_cmd("Page.printToPDF", {"printBackground": False})["data"]
        (self.shots / f"{self.name}-print.pdf").write_bytes(base64.b64decode(pdf))
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def check_report(driver, path, shots, made_up):
    report = Report(driver, path, shots)
    report.emulate(1280, 900, "light")
    report.check_charts()
    told = "curves"
    if report.has_replay:
        report.check_replay()
        frames = report.script("return powderline.replay.frames.length")
        particles = report.script("return powderline.replay.about.particles")
        told += f", replay of {particles} particles and {frames} frames, drawn {report.rate:.0f} times a second"
        if made_up:
            report.check_particle()
    report.check_widths()
    report.check_touch()
    report.take_screenshots()
    report.check_quiet()
    print(f"{path.name}: {told}; {path.stat().st_size / 1e6:.2f} MB, no request, nothing in the console")


def check_without_webgl(driver, path, shots):
    report = Report(driver, path, shots)
    if not report.has_replay:
        return
    report.emulate(1280, 900, "light")
    report.check_charts()
    until(lambda: report.find("#replay-trouble").is_displayed(), "a sentence in place of the replay")
    check("WebGL" in report.find("#replay-trouble").text, report.find("#replay-trouble").text)
    check(not report.find("#player").is_displayed(), "controls without a replay")
    report.screenshot("without-webgl")
    print(f"{path.name}, without WebGL: curves, and \"{report.find('#replay-trouble').text}\"")


def main():
    arguments = sys.argv[1:]
    made_up = arguments[:1] == ["--made-up"]
    shots, *paths = map(pathlib.Path, arguments[made_up:])
    with chromium(WITH_WEBGL) as driver:
        for index, path in enumerate(paths):
            check_report(driver, path, shots, made_up and index == 0)
    with chromium(WITHOUT_WEBGL) as driver:
        for path in paths:
            check_without_webgl(driver, path, shots)


if __name__ == "__main__":
    main()
