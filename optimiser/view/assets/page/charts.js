// Curves as SVG, drawn anew for each width so that letters keep their size.

const SVG = 'http://www.w3.org/2000/svg';
const MARGIN = { top: 10, right: 14, bottom: 42, left: 58 };
/** More room at the top, where a mark's label stands. */
const LABEL_TOP = 22;
const COLOURS = 6;
const PRINTED_WIDTH = 320;
/** Pixels from the middle of one number to that of the next, upwards. */
const LEAST_APART = 15;

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

/** A mark of an axis: the number, and how it is written, which is no rounded one. */
function mark(digit, power) {
  // Read as text, for sums and products of binary numbers are not what they seem.
  const value = Number(`${digit}e${power}`) || 0;
  return { value, text: written(value, Math.max(-power, 0)) };
}

/** A number with so many decimals; far from one by a power of ten, for there is little room beside an axis. */
function written(value, decimals) {
  if (value !== 0 && (Math.abs(value) >= 1e6 || decimals > 4)) {
    return Number(value.toPrecision(12)).toExponential().replace('e+', 'e');
  }
  if (value === 0) return '0';
  return value.toLocaleString('en', {
    minimumFractionDigits: decimals, maximumFractionDigits: decimals, useGrouping: Math.abs(value) >= 1e4,
  });
}

/** About `count` marks from low to high, 1, 2 or 5 times a power of ten apart; whole numbers, if all values are. */
function linearMarks(low, high, count, whole) {
  const rough = (high - low) / Math.max(count, 1);
  let power = Math.floor(Math.log10(rough));
  const share = rough / 10 ** power;
  // Between two steps the border is their geometric mean.
  let digit = [[1, Math.sqrt(2)], [2, Math.sqrt(10)], [5, Math.sqrt(50)]].find(([, below]) => share < below)?.[0];
  if (!digit) [digit, power] = [1, power + 1];
  if (whole && power < 0) [digit, power] = [1, 0];
  const step = digit * 10 ** power;
  const from = Math.ceil(low / step - 1e-9);
  const to = Math.floor(high / step + 1e-9);
  return Array.from({ length: Math.max(to - from + 1, 0) }, (_, i) => mark((from + i) * digit, power));
}

/** What the marks of a logarithmic axis are powers of ten times of: 1, 2 and 5, or only 1 where there is no room. */
function logDigits(low, high, pixels) {
  const most = Math.log10(high / low) + 2 * Math.log10(2.5);
  return (Math.log10(2) * pixels) / most >= LEAST_APART ? [1, 2, 5] : [1];
}

/** Marks between two numbers at these digits times powers of ten. */
function logMarks(low, high, digits) {
  const powers = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power += 1) powers.push(power);
  return powers.flatMap((power) => digits.map((digit) => mark(digit, power)))
    .filter(({ value }) => value >= low && value <= high);
}

/** Logarithms of the marks about two numbers, with a little room: the ends of a logarithmic axis. */
function logEnds(low, high, digits) {
  const near = (value) => [...digits, 10].map((digit) => digit * 10 ** Math.floor(Math.log10(value)));
  const ends = [near(low).findLast((mark) => mark <= low) ?? low, near(high).find((mark) => mark >= high) ?? high];
  const [from, to] = ends.map(Math.log10);
  return [from - 0.02 * (to - from), to + 0.02 * (to - from)];
}

/** A number in few digits: enough to tell it from others `step` away. */
function told(value, step) {
  if (value === null || !Number.isFinite(value)) return '–';
  if (value !== 0 && (Math.abs(value) >= 1e7 || Math.abs(value) < 1e-4)) return value.toExponential(2);
  const digits = Math.min(Math.max(Math.ceil(-Math.log10(step) - 1e-9), 0), 8);
  const rounded = Number(value.toFixed(digits)) || 0;
  return rounded.toLocaleString('en', { maximumFractionDigits: 8, useGrouping: Math.abs(value) >= 1e4 });
}

/** Lowest and highest of what is a number: too many for the arguments of a call. */
function endsOf(numbers) {
  return numbers.filter(isNumber)
    .reduce(([low, high], number) => [Math.min(low, number), Math.max(high, number)], [Infinity, -Infinity]);
}

/** The same a little apart, and never the same. */
function rangeOf(numbers, padding) {
  const [low, high] = endsOf(numbers);
  if (low > high) return [0, 1];
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

const isNumber = (value) => value !== null && Number.isFinite(value);
const isWhole = (values) => values.filter(isNumber).every(Number.isInteger);

/** Below, a number is zero but for rounding, and has no place on a logarithmic axis. */
const LEAST_LOGARITHMIC = 1e-12;

/** Whether y goes up by powers of ten: where it may, and where numbers above zero span more than one. */
function isLog(chart) {
  const [low, high] = endsOf(chart.series.flatMap((series) => series.points.map(([, y]) => y)));
  return chart.y_scale === 'log-if-wide' && low >= LEAST_LOGARITHMIC && high > 10 * low;
}

/** An axis up the picture: its ends, its marks, and the share of its length at which a number lies. */
function upwards(chart, height) {
  const ys = chart.series.flatMap((series) => series.points.map(([, y]) => y));
  const most = Math.max(3, Math.floor((height - LABEL_TOP - MARGIN.bottom) / 24));
  if (isLog(chart)) {
    const ends = endsOf(ys);
    const digits = logDigits(...ends, height - LABEL_TOP - MARGIN.bottom);
    const [low, high] = logEnds(...ends, digits);
    // A band may reach below zero, where there are no logarithms.
    const share = (y) => (Math.log10(Math.max(y, 10 ** low)) - low) / (high - low);
    return { marks: logMarks(10 ** low, 10 ** high, digits), share };
  }
  const bands = chart.series.flatMap((series) => series.band ?? []).flat();
  const isShare = chart.y_scale === 'share';
  const [low, high] = isShare ? [0, 1] : rangeOf([...ys, ...bands], 0.06);
  const marks = linearMarks(low, high, Math.min(most, 6), !isShare && isWhole(ys));
  return { marks, share: (y) => (y - low) / (high - low) };
}

/** Where numbers of a chart lie in a picture of a size. */
function frameOf(chart, width, height) {
  const xs = chart.series.flatMap((series) => series.points.map(([x]) => x));
  const [least, most] = endsOf(xs);
  // Before a single epoch there is none.
  const [xLow, xHigh] = least === most && isWhole(xs) ? [least, least + 1] : rangeOf(xs, 0);
  const [right, bottom] = [width - MARGIN.right, height - MARGIN.bottom];
  const up = upwards(chart, height);
  const top = chart.marks.some(([, { kind }]) => kind === 'chosen') ? LABEL_TOP : MARGIN.top;
  return {
    top, right, bottom, width, height, xLow, xHigh,
    x: (value) => MARGIN.left + ((value - xLow) / (xHigh - xLow)) * (right - MARGIN.left),
    y: (value) => bottom - up.share(value) * (bottom - top),
    xMarks: linearMarks(xLow, xHigh, Math.min(Math.max(2, Math.floor(width / 60)), 10), isWhole(xs)),
    yMarks: up.marks,
  };
}

/** What tells a number of this chart from the next. */
const stepOf = (marks) => (marks.length > 1 ? marks[1].value - marks[0].value : Math.abs(marks[0]?.value) || 1);

function axes(chart, frame) {
  const text = (className, x, y, anchor, words) =>
    svg('text', { class: className, x, y, 'text-anchor': anchor }, [words]);
  const across = frame.yMarks.flatMap((mark) => {
    const y = frame.y(mark.value);
    return [
      svg('line', { class: 'grid', x1: MARGIN.left, x2: frame.right, y1: y, y2: y }),
      text('tick up', MARGIN.left - 8, y + 4, 'end', mark.text),
    ];
  });
  const along = frame.xMarks.flatMap((mark) => {
    const x = frame.x(mark.value);
    return [
      svg('line', { class: 'mark', x1: x, x2: x, y1: frame.bottom, y2: frame.bottom + 4 }),
      text('tick along', x, frame.bottom + 17, 'middle', mark.text),
    ];
  });
  const base = svg('line', {
    class: 'axis', x1: MARGIN.left, x2: frame.right, y1: frame.bottom, y2: frame.bottom,
  });
  const name = text('label', (MARGIN.left + frame.right) / 2, frame.height - 5, 'middle', chart.x_label);
  return [...across, ...along, base, name];
}

/** The shaded part of the x axis. */
function shadeOf(chart, frame) {
  if (!chart.shade) return [];
  const within = (x) => frame.x(Math.min(Math.max(x, frame.xLow), frame.xHigh));
  const [from, to] = [within(chart.shade.from), within(chart.shade.to)];
  if (!(to > from)) return [];
  return [svg('rect', {
    class: 'shade', x: from, y: frame.top, width: to - from, height: frame.bottom - frame.top,
  })];
}

/** A sign of a mark about the middle of its own coordinates: a ring or a cross. */
function sign(kind) {
  if (kind === 'chosen') return svg('circle', { class: 'sign', r: 5.5 });
  return svg('path', { class: 'sign', d: 'M-4.5,-4.5L4.5,4.5M-4.5,4.5L4.5,-4.5' });
}

/** Signs on every curve at the x of each mark; what was chosen has a line and its label besides. */
function signs(chart, frame) {
  const at = new Map();
  for (const [x, y] of chart.series.filter(({ reference }) => !reference).flatMap(({ points }) => points)) {
    if (isNumber(y)) at.set(x, [...(at.get(x) ?? []), y]);
  }
  return chart.marks.filter(([x]) => x >= frame.xLow && x <= frame.xHigh).flatMap(([x, { kind, label }]) => {
    const on = (at.get(x) ?? []).map((y) => {
      const placed = sign(kind);
      placed.setAttribute('transform', `translate(${frame.x(x).toFixed(1)},${frame.y(y).toFixed(1)})`);
      placed.classList.add(kind);
      return placed;
    });
    if (kind !== 'chosen') return on;
    const place = frame.x(x);
    const share = (place - MARGIN.left) / (frame.right - MARGIN.left);
    const anchor = share < 0.12 ? 'start' : share > 0.88 ? 'end' : 'middle';
    return [
      svg('line', { class: 'chosen-at', x1: place, x2: place, y1: frame.top, y2: frame.bottom }),
      svg('text', { class: 'chosen-label', x: place, y: frame.top - 8, 'text-anchor': anchor }, [label]),
      ...on,
    ];
  });
}

/** The classes of a curve and its key: its colour, and whether that came before. */
function classOf(series, index) {
  if (series.reference) return 'reference';
  const colour = series.colour ?? index;
  return `c${colour % COLOURS}${colour >= COLOURS ? ' again' : ''}`;
}

/** A band with its curve on top; a point alone is a dot. */
function curve(series, index, frame) {
  const place = ([x, y]) => [x === null ? null : frame.x(x), y === null ? null : frame.y(y)];
  const classes = classOf(series, index);
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

/** What the reader points at: a line, a dot on each curve, their numbers, and what there is to say of the place. */
function readout(chart, frame, x) {
  const step = (marks) => stepOf(marks) / 100;
  const rows = chart.series.map((series, index) => {
    const at = nearest(series.points, x);
    if (at < 0 || series.points[at][0] !== x) return null;
    return { series, colour: classOf(series, index), y: series.points[at][1], band: series.band?.[at] };
  }).filter(Boolean);
  const numbers = rows.map(({ series, colour, y, band }) => {
    const range = band ? ` (${told(band[0], step(frame.yMarks))} to ${told(band[1], step(frame.yMarks))})` : '';
    const name = html('span', `key ${colour}`, series.name);
    return html('div', 'row', name, html('b', '', `${told(y, step(frame.yMarks))}${range}`));
  });
  const remarks = chart.marks.filter(([at]) => at === x).map(([, { label, note }]) =>
    html('div', 'remark', html('b', '', label), note ? `: ${note}` : ''));
  const dots = rows.filter(({ y }) => y !== null).map(({ colour, y }) =>
    svg('circle', { class: `dot ${colour}`, cx: frame.x(x), cy: frame.y(y), r: 4 }));
  const hair = svg('line', { class: 'hair', x1: frame.x(x), x2: frame.x(x), y1: frame.top, y2: frame.bottom });
  const head = html('div', 'head', `${chart.x_label} ${told(x, step(frame.xMarks))}`);
  return { marks: [hair, ...dots], text: [head, ...numbers, ...remarks] };
}

/** Draws a chart into its figure, at a width, as often as the returned function is called. */
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

  document.addEventListener('pointerdown', (event) => {
    if (overlay && !host.contains(event.target)) leave();
  });
  return (atWidth) => {
    const width = Math.max(atWidth, 200);
    frame = frameOf(chart, width, Math.round(Math.min(Math.max(0.56 * width, 200), 320)));
    overlay = svg('g');
    const curves = chart.series.flatMap((series, index) => curve(series, index, frame));
    const picture = svg('svg', {
      viewBox: `0 0 ${frame.width} ${frame.height}`, width: frame.width, height: frame.height,
      role: 'img', tabindex: 0, 'aria-label': summaryOf(chart),
    }, [...shadeOf(chart, frame), ...axes(chart, frame), ...curves, ...signs(chart, frame), overlay]);
    picture.addEventListener('pointermove', point);
    picture.addEventListener('pointerdown', point);
    // A finger that is lifted has not gone elsewhere.
    picture.addEventListener('pointerleave', (event) => {
      if (event.pointerType !== 'touch') leave();
    });
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
  const marks = chart.marks.map(([x, { label, note }]) => `${label}: ${chart.x_label} ${x}${note ? `, ${note}` : ''}`);
  const told = [...ends, ...marks].join('; ');
  return `${chart.title}: ${unitOf(chart)} over ${chart.x_label}. ${told}. Arrow keys read values.`;
}

const unitOf = (chart) => chart.y_label + (isLog(chart) ? ', logarithmic scale' : '');

/** Names of several curves, what the signs mean and where they are, and what is shaded. */
function legendOf(chart) {
  const curves = chart.series.map((series, index) =>
    html('span', `key ${classOf(series, index)}`, series.name));
  const labels = [...new Set(chart.marks.map(([, { label }]) => label))];
  const marks = labels.map((label) => {
    const alike = chart.marks.filter(([, mark]) => mark.label === label);
    const picture = svg('svg', { viewBox: '-8 -8 16 16', width: 15, height: 15, 'aria-hidden': true }, [
      sign(alike[0][1].kind),
    ]);
    const name = alike.length > 1 && !chart.x_label.endsWith('s') ? `${chart.x_label}s` : chart.x_label;
    const where = alike.length > 6 ? `${alike.length} times` : `${name} ${alike.map(([x]) => x).join(', ')}`;
    return html('span', 'mark-key', picture, `${label}: ${where}`);
  });
  const shade = chart.shade ? [html('span', 'shade-key', chart.shade.label)] : [];
  const keys = [...(curves.length > 1 ? curves : []), ...marks, ...shade];
  return keys.length ? [html('div', 'keys', ...keys)] : [];
}

function showChart(chart) {
  const plot = html('div', 'plot');
  const figure = html('figure', 'chart', html('h2', '', chart.title), html('div', 'unit', unitOf(chart)));
  figure.append(...legendOf(chart), plot);
  const draw = drawer(chart, plot);
  let width = 0;
  new ResizeObserver(() => {
    if (plot.clientWidth === width) return;
    width = plot.clientWidth;
    draw(width);
  }).observe(plot);
  // Two of them share the width of a sheet: drawn so small, letters keep their size.
  addEventListener('beforeprint', () => draw(PRINTED_WIDTH));
  addEventListener('afterprint', () => draw(plot.clientWidth));
  return figure;
}

const charts = JSON.parse(document.getElementById('charts-data').textContent);
document.getElementById('charts').replaceChildren(...charts.map(showChart));
