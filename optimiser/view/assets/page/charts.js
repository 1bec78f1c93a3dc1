// Curves as SVG, drawn anew for each width so that letters keep their size.

const SVG = 'http://www.w3.org/2000/svg';
const MARGIN = { top: 10, right: 14, bottom: 40, left: 58 };
const COLOURS = 6;

/** An SVG element with attributes and children. */
function svg(name, attributes = {}, children = []) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

/** An HTML element with a class and children or text. */
function html(name, className, ...children) {
  const made = document.createElement(name);
  if (className) made.className = className;
  made.append(...children);
  return made;
}

/** About `count` numbers that read easily, from low to high. */
function ticks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].find((first) => first * power >= rough) * power;
  const from = Math.ceil(low / step - 1e-6);
  const to = Math.floor(high / step + 1e-6);
  return Array.from({ length: Math.max(to - from + 1, 0) }, (_, i) => (from + i) * step);
}

/** A number in few digits: enough to tell it from others `step` away. */
function told(value, step) {
  if (value === null || !Number.isFinite(value)) return '–';
  if (value !== 0 && (Math.abs(value) >= 1e7 || Math.abs(value) < 1e-4)) return value.toExponential(2);
  const digits = Math.min(Math.max(Math.ceil(-Math.log10(step) + 1e-9), 0), 8);
  const rounded = Number(value.toFixed(digits + (step < 1 && (step * 10 ** digits) % 1 > 1e-6 ? 1 : 0)));
  return (rounded || 0).toLocaleString('en', { maximumFractionDigits: 8, useGrouping: Math.abs(value) >= 1e4 });
}

/** Lowest and highest of numbers, never the same. */
function rangeOf(numbers, padding) {
  const finite = numbers.filter((number) => number !== null && Number.isFinite(number));
  const low = finite.reduce((a, b) => Math.min(a, b), Infinity);
  const high = finite.reduce((a, b) => Math.max(a, b), -Infinity);
  if (!finite.length) return [0, 1];
  const more = high > low ? padding * (high - low) : 0.5 * Math.abs(high) || 1;
  return [low - more, high + more];
}

/** Stretches of points without gaps. */
function stretches(points) {
  const whole = [[]];
  for (const point of points) {
    if (point[0] === null || point[1] === null) whole.push([]);
    else whole.at(-1).push(point);
  }
  return whole.filter((stretch) => stretch.length > 0);
}

const line = (points) => `M${points.map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`).join('L')}`;

/** Where numbers of a chart lie in a picture of a size. */
function frameOf(chart, width, height) {
  const xs = chart.series.flatMap((series) => series.points.map(([x]) => x));
  const ys = chart.series.flatMap((series) => [...series.points.map(([, y]) => y), ...(series.band ?? []).flat()]);
  const [xLow, xHigh] = rangeOf(xs, 0);
  const [yLow, yHigh] = rangeOf(ys, 0.06);
  const [right, bottom] = [width - MARGIN.right, height - MARGIN.bottom];
  return {
    right, bottom, width, height, xLow, xHigh, yLow, yHigh,
    x: (value) => MARGIN.left + ((value - xLow) / (xHigh - xLow)) * (right - MARGIN.left),
    y: (value) => bottom - ((value - yLow) / (yHigh - yLow)) * (bottom - MARGIN.top),
    xTicks: ticks(xLow, xHigh, Math.max(2, Math.floor(width / 90))),
    yTicks: ticks(yLow, yHigh, 5),
  };
}

const stepOf = (marks) => (marks.length > 1 ? marks[1] - marks[0] : Math.abs(marks[0]) || 1);

function axes(chart, frame) {
  const text = (className, x, y, anchor, words) =>
    svg('text', { class: className, x, y, 'text-anchor': anchor }, [words]);
  const across = frame.yTicks.flatMap((value) => [
    svg('line', { class: 'grid', x1: MARGIN.left, x2: frame.right, y1: frame.y(value), y2: frame.y(value) }),
    text('tick', MARGIN.left - 8, frame.y(value) + 4, 'end', told(value, stepOf(frame.yTicks))),
  ]);
  const along = frame.xTicks.flatMap((value) => [
    svg('line', { class: 'mark', x1: frame.x(value), x2: frame.x(value), y1: frame.bottom, y2: frame.bottom + 4 }),
    text('tick', frame.x(value), frame.bottom + 17, 'middle', told(value, stepOf(frame.xTicks))),
  ]);
  const base = svg('line', {
    class: 'axis', x1: MARGIN.left, x2: frame.right, y1: frame.bottom, y2: frame.bottom,
  });
  const name = text('label', (MARGIN.left + frame.right) / 2, frame.height - 4, 'middle', chart.x_label);
  return [...across, ...along, base, name];
}

/** A band with its curve on top; a point alone is a dot. */
function curve(series, index, frame) {
  const place = ([x, y]) => [x === null ? null : frame.x(x), y === null ? null : frame.y(y)];
  const classes = `c${index % COLOURS}${index >= COLOURS ? ' again' : ''}`;
  const parts = stretches(series.points.map(place)).map((points) => {
    if (points.length > 1) return svg('path', { class: `curve ${classes}`, d: line(points) });
    return svg('circle', { class: `dot ${classes}`, cx: points[0][0], cy: points[0][1], r: 3 });
  });
  return [...bands(series, frame).map((d) => svg('path', { class: `band ${classes}`, d })), ...parts];
}

function bands({ points, band }, frame) {
  if (!band) return [];
  const edges = points.slice(0, band.length).map(([x], i) => [x, ...band[i]]);
  const whole = [[]];
  for (const edge of edges) {
    if (edge.includes(null)) whole.push([]);
    else whole.at(-1).push(edge);
  }
  return whole.filter((part) => part.length > 1).map((part) => {
    const low = part.map(([x, y]) => [frame.x(x), frame.y(y)]);
    const high = part.map(([x, , y]) => [frame.x(x), frame.y(y)]).reverse();
    return `${line([...low, ...high])}Z`;
  });
}

/** Index of the point of a series nearest to x; -1 if it has none. */
function nearest(points, x) {
  let best = -1;
  points.forEach(([at], i) => {
    if (at !== null && (best < 0 || Math.abs(at - x) < Math.abs(points[best][0] - x))) best = i;
  });
  return best;
}

/** What the reader points at: a line, a dot on each curve, and their numbers. */
function readout(chart, frame, x) {
  const step = (marks) => stepOf(marks) / 100;
  const rows = chart.series.map((series, index) => {
    const at = nearest(series.points, x);
    if (at < 0 || series.points[at][0] !== x) return null;
    return { series, index, y: series.points[at][1], band: series.band?.[at] };
  }).filter(Boolean);
  const numbers = rows.map(({ series, index, y, band }) => {
    const range = band ? ` (${told(band[0], step(frame.yTicks))} to ${told(band[1], step(frame.yTicks))})` : '';
    const name = html('span', `key c${index % COLOURS}`, series.name);
    return html('div', 'row', name, html('b', '', `${told(y, step(frame.yTicks))}${range}`));
  });
  const dots = rows.filter(({ y }) => y !== null).map(({ index, y }) =>
    svg('circle', { class: `dot c${index % COLOURS}`, cx: frame.x(x), cy: frame.y(y), r: 4 }));
  const hair = svg('line', { class: 'hair', x1: frame.x(x), x2: frame.x(x), y1: MARGIN.top, y2: frame.bottom });
  const head = html('div', 'head', `${chart.x_label} ${told(x, step(frame.xTicks))}`);
  return { marks: [hair, ...dots], text: [head, ...numbers] };
}

/** Draws a chart into its figure; calls of the returned function draw it again. */
function drawer(chart, host) {
  const xs = [...new Set(chart.series.flatMap(({ points }) => points.map(([x]) => x)))]
    .filter((x) => x !== null).sort((a, b) => a - b);
  const tip = html('div', 'tip');
  tip.setAttribute('role', 'status');
  let chosen = -1;
  let frame = null;
  let overlay = null;

  const choose = (index) => {
    chosen = Math.min(Math.max(index, 0), xs.length - 1);
    if (chosen < 0) return;
    const { marks, text } = readout(chart, frame, xs[chosen]);
    overlay.replaceChildren(...marks);
    tip.replaceChildren(...text);
    tip.hidden = false;
    const at = frame.x(xs[chosen]);
    const left = at > frame.width / 2 ? at - tip.offsetWidth - 12 : at + 12;
    tip.style.left = `${Math.max(0, Math.min(left, frame.width - tip.offsetWidth))}px`;
  };
  const leave = () => {
    chosen = -1;
    overlay?.replaceChildren();
    tip.hidden = true;
  };
  const point = (event) => {
    const x = event.clientX - host.getBoundingClientRect().left;
    choose(nearest(xs.map((value) => [frame.x(value)]), x));
  };
  const steps = { ArrowLeft: -1, ArrowRight: 1 };
  const key = (event) => {
    if (event.key === 'Escape') leave();
    if (!(event.key in steps)) return;
    event.preventDefault();
    choose(chosen + steps[event.key]);
  };

  return () => {
    const width = Math.max(host.clientWidth, 200);
    frame = frameOf(chart, width, Math.round(Math.min(Math.max(0.56 * width, 200), 320)));
    overlay = svg('g');
    const curves = chart.series.flatMap((series, index) => curve(series, index, frame));
    const picture = svg('svg', {
      viewBox: `0 0 ${frame.width} ${frame.height}`, width: frame.width, height: frame.height,
      role: 'img', tabindex: 0, 'aria-label': summaryOf(chart),
    }, [...axes(chart, frame), ...curves, overlay]);
    picture.addEventListener('pointermove', point);
    picture.addEventListener('pointerdown', point);
    picture.addEventListener('pointerleave', leave);
    picture.addEventListener('blur', leave);
    picture.addEventListener('keydown', key);
    host.replaceChildren(picture, tip);
    leave();
  };
}

/** A chart in one sentence, for those who do not see it. */
function summaryOf(chart) {
  const ends = chart.series.map(({ name, points }) => {
    const known = points.filter(([, y]) => y !== null);
    if (!known.length) return `${name}: nothing`;
    const tell = (value) => Number(value.toPrecision(4));
    return `${name}: from ${tell(known[0][1])} to ${tell(known.at(-1)[1])}`;
  });
  return `${chart.title}: ${chart.y_label} over ${chart.x_label}. ${ends.join('; ')}. Arrow keys read values.`;
}

function legendOf(chart) {
  const key = ({ name }, index) =>
    html('span', `key c${index % COLOURS}${index >= COLOURS ? ' again' : ''}`, name);
  return chart.series.length > 1 ? [html('div', 'keys', ...chart.series.map(key))] : [];
}

function showChart(chart) {
  const plot = html('div', 'plot');
  const figure = html('figure', 'chart', html('h2', '', chart.title), html('div', 'unit', chart.y_label));
  figure.append(...legendOf(chart), plot);
  const draw = drawer(chart, plot);
  let width = 0;
  new ResizeObserver(() => {
    if (plot.clientWidth === width) return;
    width = plot.clientWidth;
    draw();
  }).observe(plot);
  return figure;
}

const charts = JSON.parse(document.getElementById('charts-data').textContent);
document.getElementById('charts').replaceChildren(...charts.map(showChart));
