// Unpacks what `src/page/replay.rs` packed; the table at its top says how.

/** Inflated bytes of a base64 element. The element goes: it is large, and nobody asks twice. */
async function inflated(id) {
  const element = document.getElementById(id);
  const text = atob(element.textContent);
  element.remove();
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Adds one axis' steps to the positions before: low bytes first, then high ones. */
function addSteps(bytes, at, count, axis, frame) {
  for (let i = 0; i < count; i += 1) {
    const step = bytes[at + i] | (bytes[at + count + i] << 8);
    frame[4 * i + axis] += (step >> 1) ^ -(step & 1);
  }
}

/**
 * Frames as the graphics card takes them: four 16-bit shares a particle, x, y, z of the volume and the speed of the
 * fastest.
 */
function unpackedFrames(bytes, about) {
  const count = about.particles;
  const storesSpeeds = about.fastest_m_s !== null;
  const codes = new Uint8Array(count);
  let at = 0;
  let before = new Uint16Array(4 * count);
  return about.times_s.map(() => {
    const frame = before.slice();
    for (let axis = 0; axis < 3; axis += 1, at += 2 * count) addSteps(bytes, at, count, axis, frame);
    if (storesSpeeds) {
      for (let i = 0; i < count; i += 1) {
        codes[i] += bytes[at + i];
        frame[4 * i + 3] = Math.round((codes[i] / 255) ** 2 * 65535);
      }
      at += count;
    }
    before = frame;
    return frame;
  });
}

/** Metres a second between two frames, for every particle. */
function speedsBetween(from, to, seconds, about) {
  const metres = about.size_m.map((size) => size / 65535);
  return Float32Array.from({ length: about.particles }, (_, i) => {
    const along = (axis) => (to[4 * i + axis] - from[4 * i + axis]) * metres[axis];
    return Math.hypot(along(0), along(1), along(2)) / seconds;
  });
}

/** Speeds from the positions of the frames before and after, where the page has none. Returns the fastest, m/s. */
function deriveSpeeds(frames, about) {
  const last = frames.length - 1;
  const speeds = frames.map((_, k) => {
    const [a, b] = [Math.max(k - 1, 0), Math.min(k + 1, last)];
    return speedsBetween(frames[a], frames[b], Math.max(about.times_s[b] - about.times_s[a], 1e-9), about);
  });
  const fastest = Math.max(1e-9, speeds.reduce((top, row) => row.reduce((a, b) => Math.max(a, b), top), 0));
  speeds.forEach((row, k) => row.forEach((speed, i) => {
    frames[k][4 * i + 3] = Math.round((speed / fastest) * 65535);
  }));
  return fastest;
}

/** The value below which the given share of the particles that move stays, in all frames: 16-bit share of the fastest. */
function quantileOfMoving(frames, share) {
  const counts = new Uint32Array(65536);
  for (const frame of frames) for (let i = 3; i < frame.length; i += 4) counts[frame[i]] += 1;
  // Slower than a hundredth of the fastest is at rest, or nearly.
  let left = (1 - share) * counts.subarray(655).reduce((sum, count) => sum + count, 0);
  for (let value = 65535; value > 655; value -= 1) {
    left -= counts[value];
    if (left < 0) return value;
  }
  return 65535;
}

/** The replay's data: what the page says about it, frames, and the ranges of what is shown in colour. */
async function readReplay() {
  const about = JSON.parse(document.getElementById('replay-data').textContent);
  const frames = unpackedFrames(await inflated('replay-powder'), about);
  const fastest = about.fastest_m_s ?? deriveSpeeds(frames, about);
  let highest = 0;
  for (const frame of frames) for (let i = 2; i < frame.length; i += 4) highest = Math.max(highest, frame[i]);
  return {
    about,
    frames,
    fastest_m_s: fastest,
    // A few stray grains would else leave all others in one colour.
    speedRange: [0, roundedUp((fastest * quantileOfMoving(frames, 0.995)) / 65535)],
    heightRange: [0, roundedUp((about.size_m[2] * highest) / 65535)],
    /** Frame before a time, frame after it, and how far it is from the one to the other. */
    at(time) {
      const times = about.times_s;
      let low = 0;
      let high = times.length - 1;
      while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (times[middle] <= time) low = middle;
        else high = middle;
      }
      const span = times[high] - times[low];
      const share = span > 0 ? Math.min(Math.max((time - times[low]) / span, 0), 1) : 0;
      return { from: low, to: high, share };
    },
    /** Where a particle is in a frame, metres. */
    position(frame, particle) {
      return about.size_m.map((size, axis) => (frames[frame][4 * particle + axis] / 65535) * size);
    },
  };
}

/** The next number that reads easily: 1, 1.5, 2, 3, 4, 5, 6 or 8 of a power of ten. */
function roundedUp(value) {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  const first = [1, 1.5, 2, 3, 4, 5, 6, 8, 10].find((step) => step * power >= value * 0.9999) ?? 10;
  return first * power;
}
