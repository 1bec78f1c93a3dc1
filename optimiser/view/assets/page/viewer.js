// The replay: powder, tool, containers and gates in 3-D, played by time. Needs `powder.js` in front of it.

/**
 * Colours along a scale, from its low end to its high end, ever darker. All are warm: blue and grey are what the powder
 * is poured from and into, which all kinds of eyes tell apart.
 */
const RAMPS = {
  speed: ['#d9c7a0', '#e6a93c', '#de7a18', '#c9471d', '#9c1f2e'],
  height: ['#eddcae', '#dcb45c', '#bd8430', '#8f5a20', '#5f3716'],
};

/** Where particles end, by the digit the page stores. Warm as well: alike for no kind of eyes, nor like a container. */
const DESTINATIONS = [
  ['in the source', '#c9b27c'],
  ['in the target', '#5f3716'],
  ['on the tool', '#e69f00'],
  ['spilled', '#c9471d'],
  ['on a rim', '#ffe86b'],
  ['in flight', '#f7b6a5'],
];

/** Directions to look from, where the front is that of -y; z is up. */
const VIEWS = { oblique: [0.32, -1, 0.5], front: [0, -1, 0.001], side: [1, 0, 0.001], top: [0, -0.001, 1] };

const MODES = ['speed', 'height', 'destination'];

const POWDER_VERTEX = `
  in vec4 before;
  in vec4 after;
  in float destination;
  uniform float share, diameter, pixels, fastest;
  uniform int mode;
  uniform vec2 range;
  uniform vec3 size;
  uniform vec3 destinations[6];
  uniform sampler2D ramp;
  out vec3 tint;

  void main() {
    vec4 state = mix(before, after, share);
    vec3 place = size * state.xyz;
    gl_Position = projectionMatrix * modelViewMatrix * vec4(place, 1.0);
    gl_PointSize = max(1.5, 0.5 * diameter * pixels * projectionMatrix[1][1] / gl_Position.w);
    float value = mode == 0 ? fastest * state.w : place.z;
    float along = clamp((value - range.x) / (range.y - range.x), 0.0, 1.0);
    tint = mode == 2 ? destinations[int(destination + 0.5)] : texture(ramp, vec2(along, 0.5)).rgb;
  }`;

// A ball on a square: where it is hit, its normal is known.
const POWDER_FRAGMENT = `
  in vec3 tint;

  void main() {
    vec2 at = vec2(2.0, -2.0) * (gl_PointCoord - 0.5);
    float outwards = dot(at, at);
    if (outwards > 1.0) discard;
    vec3 normal = vec3(at, sqrt(1.0 - outwards));
    float lit = max(dot(normal, normalize(vec3(-0.4, 0.7, 0.6))), 0.0);
    gl_FragColor = vec4(tint * (0.4 + 0.7 * lit), 1.0);
    #include <colorspace_fragment>
  }`;

const element = (id) => document.getElementById(id);

/** A colour of the style sheet, which knows light and dark. */
const styled = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Modules of the library. They name each other, so each is unpacked with the others' addresses in place of names. */
async function library() {
  const decoder = new TextDecoder();
  const address = async (id, name, of) => {
    const text = decoder.decode(await inflated(id));
    const linked = name ? text.replaceAll(`"${name}"`, `"${of}"`).replaceAll(`'${name}'`, `'${of}'`) : text;
    return URL.createObjectURL(new Blob([linked], { type: 'text/javascript' }));
  };
  const core = await address('three-core');
  const three = await address('three-module', './three.core.min.js', core);
  const orbit = await address('three-orbit', 'three', three);
  return { THREE: await import(three), OrbitControls: (await import(orbit)).OrbitControls };
}

// ---- What stands and moves on the stage ----

/** Geometry of a mesh whose edges stay sharp where faces meet at more than 35 degrees. */
function creased(THREE, { points_m, corners }) {
  const shared = new THREE.BufferGeometry();
  shared.setAttribute('position', new THREE.Float32BufferAttribute(points_m, 3));
  shared.setIndex(corners);
  const geometry = shared.toNonIndexed();
  geometry.computeVertexNormals();
  const faces = geometry.getAttribute('normal');
  const around = new Map();
  const normal = (i) => new THREE.Vector3().fromBufferAttribute(faces, i);
  corners.forEach((corner, i) => around.set(corner, [...(around.get(corner) ?? []), normal(i)]));
  const normals = corners.flatMap((corner, i) => {
    const own = normal(i);
    const alike = around.get(corner).filter((other) => other.dot(own) > Math.cos(0.61));
    return alike.reduce((sum, other) => sum.add(other), new THREE.Vector3()).normalize().toArray();
  });
  geometry.setAttribute('normal', new THREE.Float32BufferAttribute(normals, 3));
  return { solid: geometry, edges: new THREE.EdgesGeometry(shared, 35) };
}

/** A body one can see into: faint faces, clear edges. `colour` names one of the style sheet. */
function glass(THREE, mesh, colour, opacity, edgeOpacity) {
  const { solid, edges } = creased(THREE, mesh);
  const faces = new THREE.MeshLambertMaterial({
    transparent: true, opacity, depthWrite: false, side: THREE.DoubleSide,
  });
  const lines = new THREE.LineBasicMaterial({ transparent: true, opacity: edgeOpacity });
  const group = new THREE.Group();
  group.add(new THREE.Mesh(solid, faces), new THREE.LineSegments(edges, lines));
  group.userData.colour = colour;
  return group;
}

/** The planned tool: wire where it bends, so that it reads as a drawing over the tool itself. */
function ghost(THREE, mesh) {
  const group = glass(THREE, mesh, '--planned', 0.07, 0.95);
  const shared = new THREE.BufferGeometry();
  shared.setAttribute('position', new THREE.Float32BufferAttribute(mesh.points_m, 3));
  shared.setIndex(mesh.corners);
  const wire = new THREE.LineBasicMaterial({ transparent: true, opacity: 0.2 });
  group.add(new THREE.LineSegments(new THREE.EdgesGeometry(shared, 1), wire));
  return group;
}

/** Rods with round ends: `place(k, ends)` puts number k where the six numbers of its ends say. */
function rods(THREE, radii, ends, colour) {
  const group = new THREE.Group();
  group.userData.colour = colour;
  const [from, to, up] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3(0, 1, 0)];
  radii.forEach((radius, k) => {
    const length = from.fromArray(ends, 6 * k).distanceTo(to.fromArray(ends, 6 * k + 3));
    group.add(new THREE.Mesh(new THREE.CapsuleGeometry(radius, length, 8, 32), new THREE.MeshLambertMaterial()));
  });
  const place = (k, numbers) => {
    const rod = group.children[k];
    from.fromArray(numbers);
    to.fromArray(numbers, 3);
    rod.position.copy(from).add(to).multiplyScalar(0.5);
    rod.quaternion.setFromUnitVectors(up, to.sub(from).normalize());
  };
  return { group, place };
}

/** The arm, and `show(at)` that puts it where it is between two frames; and the block that the bench stands on. */
function armOf(THREE, { arm }) {
  const group = new THREE.Group();
  if (!arm) return { group, show: () => {} };
  const still = arm.standing_m.length / 6;
  const { group: links, place } = rods(THREE, arm.radii_m, [...arm.standing_m, ...arm.moving_m[0]], '--arm');
  for (let k = 0; k < still; k += 1) place(k, arm.standing_m.slice(6 * k, 6 * k + 6));
  group.add(links);
  if (arm.stand_m) {
    const [low, high] = arm.stand_m.map((corner) => new THREE.Vector3(...corner));
    const size = high.clone().sub(low);
    const block = new THREE.BoxGeometry(...size);
    // Its top is the floor, with the grid's lines on it.
    block.translate(...low.add(high).multiplyScalar(0.5).toArray());
    const solid = new THREE.MeshLambertMaterial({ polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
    const stand = new THREE.Group();
    stand.userData.colour = '--stand';
    stand.add(new THREE.Mesh(block, solid));
    group.add(stand);
  }
  const show = ({ from, to, share }) => {
    const [before, after] = [arm.moving_m[from], arm.moving_m[to]];
    const between = before.map((number, i) => number + share * (after[i] - number));
    for (let k = still; k < arm.radii_m.length; k += 1) place(k, between.slice(6 * (k - still), 6 * (k - still) + 6));
  };
  return { group, show };
}

/** The way of a tool's origin, as a thin rod; nothing if it does not move. */
function path(THREE, poses, radius, colour) {
  const group = new THREE.Group();
  group.userData.colour = colour;
  const points = [];
  for (const pose of poses) {
    const point = new THREE.Vector3(...pose);
    if (!points.length || points.at(-1).distanceTo(point) > 2 * radius) points.push(point);
  }
  if (points.length > 1) {
    const curve = new THREE.CatmullRomCurve3(points, false, 'centripetal');
    const tube = new THREE.TubeGeometry(curve, Math.min(4 * points.length, 1500), radius, 6);
    group.add(new THREE.Mesh(tube, new THREE.MeshBasicMaterial()));
  }
  return group;
}

/** Lines on the floor beneath what is to be seen, as far as there is floor, and how far apart they are. */
function floorGrid(THREE, [low, high], ends) {
  const step = roundedUp(Math.max(high[0] - low[0], high[1] - low[1]) / 14);
  const [x, y] = [0, 1].map((axis) => {
    const [from, to] = [Math.floor(low[axis] / step + 1e-9), Math.ceil(high[axis] / step - 1e-9)];
    const lines = Array.from({ length: to - from + 1 }, (_, line) => (from + line) * step);
    return lines.filter((at) => at > ends[0][axis] - 1e-9 && at < ends[1][axis] + 1e-9);
  });
  const [left, right, near, far] = [x[0], x.at(-1), y[0], y.at(-1)];
  const points = [...x.flatMap((at) => [at, near, 0, at, far, 0]), ...y.flatMap((at) => [left, at, 0, right, at, 0])];
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute('position', new THREE.Float32BufferAttribute(points, 3));
  const lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial());
  const group = new THREE.Group();
  group.add(lines);
  group.userData.colour = '--grid';
  return { group, step };
}

/** A texture of 256 colours along a ramp. */
function rampTexture(THREE, stops) {
  const colours = stops.map((stop) => new THREE.Color().setStyle(stop, THREE.LinearSRGBColorSpace));
  const pixels = new Uint8Array(4 * 256);
  for (let i = 0; i < 256; i += 1) {
    const along = (i / 255) * (stops.length - 1);
    const at = Math.min(Math.floor(along), stops.length - 2);
    const colour = colours[at].clone().lerp(colours[at + 1], along - at);
    pixels.set([colour.r, colour.g, colour.b, 1].map((share) => Math.round(255 * share)), 4 * i);
  }
  const texture = new THREE.DataTexture(pixels, 256, 1);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.magFilter = THREE.LinearFilter;
  texture.minFilter = THREE.LinearFilter;
  texture.needsUpdate = true;
  return texture;
}

/** The powder, and `show(at)` that puts it where it is between two frames. */
function powder(THREE, replay) {
  const { about, frames } = replay;
  const attribute = (frame) => {
    const numbers = new THREE.BufferAttribute(frames[frame], 4, true);
    return numbers.setUsage(THREE.DynamicDrawUsage);
  };
  const [before, after] = [attribute(0), attribute(0)];
  const digits = Uint8Array.from(about.destinations ?? '', Number);
  const destination = digits.length ? digits : new Uint8Array(about.particles);
  const geometry = new THREE.BufferGeometry();
  // The library counts particles by the attribute of this name.
  geometry.setAttribute('position', before);
  geometry.setAttribute('before', before);
  geometry.setAttribute('after', after);
  geometry.setAttribute('destination', new THREE.BufferAttribute(destination, 1));
  const uniforms = {
    share: { value: 0 },
    diameter: { value: 0.52 * about.cell_m },
    pixels: { value: 1 },
    fastest: { value: replay.fastest_m_s },
    mode: { value: 0 },
    range: { value: new THREE.Vector2() },
    size: { value: new THREE.Vector3(...about.size_m) },
    destinations: { value: DESTINATIONS.map(([, colour]) => new THREE.Color(colour)) },
    ramp: { value: null },
  };
  const material = new THREE.ShaderMaterial({
    uniforms, vertexShader: POWDER_VERTEX, fragmentShader: POWDER_FRAGMENT,
  });
  const points = new THREE.Points(geometry, material);
  points.frustumCulled = false;
  const swap = (numbers, frame) => {
    if (numbers.array === frames[frame]) return;
    numbers.array = frames[frame];
    numbers.needsUpdate = true;
  };
  const show = ({ from, to, share }) => {
    swap(before, from);
    swap(after, to);
    uniforms.share.value = share;
  };
  return { points, uniforms, show };
}

/** Names under the containers: `place(camera, width, height)` puts each where its container is seen lowest. */
function nameTags(THREE, containers, host) {
  const tags = containers.map(({ name, role, mesh }) => {
    const tag = document.createElement('span');
    tag.className = `of-${role}`;
    tag.textContent = role === 'bystander' || name === role ? name : `${name} (${role})`;
    const box = new THREE.Box3().setFromArray(mesh.points_m);
    const pick = (corner, axis) => (corner & (1 << axis) ? box.max : box.min).getComponent(axis);
    const corners = Array.from({ length: 8 }, (_, i) => new THREE.Vector3(pick(i, 0), pick(i, 1), pick(i, 2)));
    return { tag, corners };
  });
  host.replaceChildren(...tags.map(({ tag }) => tag));
  const seen = new THREE.Vector3();
  /** The rectangle in which a container is seen; nothing if some of it is behind the eye, or all of it out of sight. */
  const rectangle = (corners, camera, width, height) => {
    const ends = { left: Infinity, right: -Infinity, top: Infinity, bottom: -Infinity };
    for (const corner of corners) {
      seen.copy(corner).project(camera);
      if (seen.z > 1) return null;
      const [x, y] = [(0.5 + 0.5 * seen.x) * width, (0.5 - 0.5 * seen.y) * height];
      [ends.left, ends.right] = [Math.min(ends.left, x), Math.max(ends.right, x)];
      [ends.top, ends.bottom] = [Math.min(ends.top, y), Math.max(ends.bottom, y)];
    }
    return ends.right < 0 || ends.left > width || ends.bottom < 0 || ends.top > height ? null : ends;
  };
  /** What else is written on the stage, which names keep off. */
  const around = (at) => {
    const from = at.getBoundingClientRect();
    return [...at.parentElement.querySelectorAll('.views, .scale')].map((other) => other.getBoundingClientRect())
      .map(({ left, top, width, height }) => ({ left: left - from.left, top: top - from.top, wide: width, tall: height }));
  };
  const names = {
    get visible() { return !host.hidden; },
    set visible(on) { host.hidden = !on; },
    place(camera, width, height) {
      if (host.hidden) return;
      const taken = around(host);
      tags.forEach(({ tag, corners }) => {
        const ends = rectangle(corners, camera, width, height);
        tag.hidden = !ends;
        if (!ends) return;
        const [wide, tall] = [tag.offsetWidth, tag.offsetHeight];
        const clamped = (value, most) => Math.max(2, Math.min(value, most - 2));
        const left = clamped(0.5 * (ends.left + ends.right) - 0.5 * wide, width - wide);
        let top = clamped(ends.bottom + 3, height - tall);
        // Names do not lie on each other: the next one goes below, or above where there is no room.
        const hit = () => taken.find((other) => left < other.left + other.wide && other.left < left + wide
          && top < other.top + other.tall && other.top < top + tall);
        for (let other = hit(); other && top + tall < height; other = hit()) top = other.top + other.tall + 1;
        for (let other = hit(); other && top > 0; other = hit()) top = other.top - tall - 1;
        taken.push({ left, top, wide, tall });
        // In shares, for paper is of another size.
        tag.style.left = `${((100 * (left + 0.5 * wide)) / width).toFixed(2)}%`;
        tag.style.top = `${((100 * top) / height).toFixed(2)}%`;
      });
    },
  };
  return names;
}

// ---- The stage ----

/** Everything on the stage, and how to light, look at and draw it. */
function makeStage({ THREE, OrbitControls }, replay, host) {
  const { about } = replay;
  const renderer = new THREE.WebGLRenderer({ antialias: true });
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(32, 1, 0.01, 100);
  camera.up.set(0, 0, 1);
  const grid = floorGrid(THREE, about.extent_m, about.arm?.stand_m ?? [[-Infinity, -Infinity], [Infinity, Infinity]]);
  const arm = armOf(THREE, about);
  const layers = {
    arm: arm.group,
    source: new THREE.Group(),
    target: new THREE.Group(),
    bystander: new THREE.Group(),
    gate: new THREE.Group(),
    tool: glass(THREE, about.tool, '--tool', 0.5, 0.9),
    planned: new THREE.Group(),
    path: path(THREE, about.poses, 0.1 * about.cell_m, '--executed'),
  };
  for (const { mesh, role } of about.containers) {
    // Faint: the powder within is to keep its colour.
    layers[role].add(glass(THREE, mesh, `--${role}`, 0.07, 0.9));
  }
  const gates = about.gates.map(({ mesh, moved_m: moved }) => {
    const solid = glass(THREE, mesh, '--gate', 0.07, 0.9);
    layers.gate.add(solid);
    return { solid, moved };
  });
  const plannedTool = ghost(THREE, about.tool);
  const plannedPoses = about.planned.filter((pose) => pose);
  layers.planned.add(plannedTool, path(THREE, plannedPoses, 0.1 * about.cell_m, '--planned'));
  const grains = powder(THREE, replay);
  const ramps = Object.fromEntries(Object.entries(RAMPS).map(([name, stops]) => [name, rampTexture(THREE, stops)]));
  const sun = new THREE.DirectionalLight(0xffffff, 2.2);
  scene.add(grid.group, grains.points, ...Object.values(layers), new THREE.HemisphereLight(0xffffff, 0x8a93a0, 1.6));
  // The light comes with the eye, so that no side is ever dark.
  sun.position.set(-0.4, 0.8, 0.6);
  camera.add(sun);
  scene.add(camera);
  host.prepend(renderer.domElement);
  const canvas = renderer.domElement;
  canvas.setAttribute('role', 'img');
  canvas.setAttribute('aria-label', `Powder, tool and containers of ${about.name} in 3-D`);
  canvas.dataset.drawn = '0';
  const controls = new OrbitControls(camera, canvas);
  controls.zoomToCursor = true;
  const extent = new THREE.Box3(...about.extent_m.map((corner) => new THREE.Vector3(...corner)));
  // An arm stands behind the bench.
  const front = THREE.MathUtils.degToRad(about.front_deg);
  const directionOf = (view) => new THREE.Vector3(...VIEWS[view]).applyAxisAngle(new THREE.Vector3(0, 0, 1), front).toArray();
  // Until the reader turns it, the picture fits, however the window changes.
  let looksFrom = null;
  controls.addEventListener('start', () => { looksFrom = null; });
  const names = nameTags(THREE, about.containers, element('names'));

  const place = (group, a, b, share) => {
    const [p, q] = [a, b].map((pose) => new THREE.Vector3(pose[0], pose[1], pose[2]));
    const [r, s] = [a, b].map((pose) => new THREE.Quaternion(pose[3], pose[4], pose[5], pose[6]));
    group.position.copy(p.lerp(q, share));
    group.quaternion.copy(r.slerp(s, share));
  };

  return {
    canvas, camera, controls, powderColours: [...Object.values(RAMPS).flat(), ...DESTINATIONS.map(([, colour]) => colour)],
    layers: { ...layers, names }, gridStep: grid.step,
    show(time) {
      const at = replay.at(time);
      grains.show(at);
      arm.show(at);
      place(layers.tool, about.poses[at.from], about.poses[at.to], at.share);
      for (const { solid, moved } of gates) {
        // Between the last frame that has it and the first that has not, it belongs to the nearer one.
        const [from, to] = [moved[at.from], moved[at.to]];
        solid.visible = Boolean(at.share < 0.5 ? from : to);
        if (from ?? to) solid.position.set(...(from ?? to)).lerp(new THREE.Vector3(...(to ?? from)), at.share);
      }
      const [a, b] = [about.planned[at.from], about.planned[at.to]];
      plannedTool.visible = Boolean(a ?? b);
      if (a ?? b) place(plannedTool, a ?? b, b ?? a, at.share);
      canvas.dataset.frame = String(at.share < 0.5 ? at.from : at.to);
    },
    colourBy(mode) {
      grains.uniforms.mode.value = MODES.indexOf(mode);
      grains.uniforms.ramp.value = ramps[mode] ?? ramps.speed;
      grains.uniforms.range.value.set(...(mode === 'height' ? replay.heightRange : replay.speedRange));
    },
    /** Colours of the style sheet. */
    restyle() {
      renderer.setClearColor(styled('--stage'));
      scene.traverse((group) => {
        if (!group.userData.colour) return;
        const colour = styled(group.userData.colour);
        group.children.forEach((child) => child.material?.color.set(colour));
      });
    },
    resize() {
      const { clientWidth: width, clientHeight: height } = host;
      host.style.setProperty('--aspect', String(width / Math.max(height, 1)));
      renderer.setPixelRatio(Math.min(globalThis.devicePixelRatio, 2));
      renderer.setSize(width, height, false);
      camera.aspect = width / Math.max(height, 1);
      camera.updateProjectionMatrix();
      grains.uniforms.pixels.value = canvas.height;
      if (looksFrom) aim(THREE, camera, controls, extent, directionOf(looksFrom));
    },
    lookFrom(view) {
      aim(THREE, camera, controls, extent, directionOf(view));
      looksFrom = view;
    },
    draw() {
      renderer.render(scene, camera);
      names.place(camera, host.clientWidth, host.clientHeight);
      canvas.dataset.drawn = String(Number(canvas.dataset.drawn) + 1);
    },
  };
}

/** Moves the camera so far back in a direction that the box just fits. */
function aim(THREE, camera, controls, box, direction) {
  const centre = box.getCenter(new THREE.Vector3());
  const towards = new THREE.Vector3(...direction).normalize();
  const right = new THREE.Vector3(0, 0, 1).cross(towards).normalize();
  const up = towards.clone().cross(right);
  const tall = Math.tan(THREE.MathUtils.degToRad(camera.fov / 2));
  let distance = 0;
  for (let corner = 0; corner < 8; corner += 1) {
    const pick = (axis) => (corner & (1 << axis) ? box.max : box.min).getComponent(axis);
    const from = new THREE.Vector3(pick(0), pick(1), pick(2)).sub(centre);
    const needed = Math.max(Math.abs(from.dot(up)), Math.abs(from.dot(right)) / camera.aspect) / tall;
    distance = Math.max(distance, needed + from.dot(towards));
  }
  camera.position.copy(centre).addScaledVector(towards, 1.06 * distance);
  camera.near = 0.02 * distance;
  camera.far = 20 * distance;
  camera.updateProjectionMatrix();
  controls.target.copy(centre);
  controls.minDistance = 0.05 * distance;
  controls.maxDistance = 5 * distance;
  controls.update();
}

// ---- Time ----

/** Time that runs while it is played. `changed` is called whenever something is to be drawn. */
function makeClock(start, end, changed) {
  const clock = {
    time: start, rate: 1, playing: false,
    set(time) {
      clock.time = Math.min(Math.max(time, start), end);
      changed();
    },
    play() {
      if (clock.time >= end) clock.time = start;
      clock.playing = true;
      changed();
    },
    pause() {
      clock.playing = false;
      changed();
    },
    toggle() {
      if (clock.playing) clock.pause();
      else clock.play();
    },
    /** Some seconds of the viewer's time have gone by. */
    pass(seconds) {
      if (!clock.playing) return;
      clock.time = Math.min(clock.time + seconds * clock.rate, end);
      if (clock.time >= end) clock.playing = false;
    },
  };
  return clock;
}

/** Draws when something changed, and all the time while the clock runs; otherwise the page is at rest. */
function makeLoop(onDraw) {
  let asked = false;
  let last = null;
  const step = (now) => {
    asked = false;
    // A page that was hidden does not catch up.
    const seconds = last === null ? 0 : Math.min((now - last) / 1000, 0.25);
    const goesOn = onDraw(seconds);
    last = goesOn ? now : null;
    if (goesOn) ask();
  };
  const ask = () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(step);
  };
  return ask;
}

// ---- Controls under the stage ----

function span(className, text) {
  const made = document.createElement('span');
  made.className = className;
  made.textContent = text;
  return made;
}

/** A colour bar with its unit, or the list of destinations with how many particles got there. */
function showLegend(mode, replay) {
  const legend = element('legend');
  if (mode === 'destination') {
    const digits = [...replay.about.destinations].map(Number);
    legend.setAttribute('aria-label', 'Where the powder ends');
    legend.replaceChildren(...DESTINATIONS.map(([name, colour], kind) => {
      const count = digits.filter((digit) => digit === kind).length;
      const entry = span('kind', `${name} ${count.toLocaleString('en')}`);
      entry.style.setProperty('--kind', colour);
      return entry;
    }));
    return;
  }
  const bar = span('bar', '');
  bar.style.background = `linear-gradient(to right, ${RAMPS[mode].join(', ')})`;
  const [label, unit, [low, high]] = {
    speed: ['Speed', 'm/s', replay.speedRange],
    height: ['Height above the floor', 'm', replay.heightRange],
  }[mode];
  const top = `${Number(high.toPrecision(3))} ${unit}${mode === 'speed' ? ' and more' : ''}`;
  legend.replaceChildren(span('low', String(low)), bar, span('high', top));
  legend.setAttribute('aria-label', `${label} from ${low} to ${top}`);
}

function bindTransport(replay, clock, changed) {
  const times = replay.about.times_s;
  element('play').addEventListener('click', clock.toggle);
  const scrub = element('scrub');
  scrub.min = String(times[0]);
  scrub.max = String(times.at(-1));
  scrub.addEventListener('input', () => {
    clock.playing = false;
    clock.set(Number(scrub.value));
  });
  element('rate').addEventListener('change', (event) => {
    clock.rate = Number(event.target.value);
    changed();
  });
}

/** What the controls say, after time has changed. */
function showTransport(replay, clock) {
  const last = replay.about.times_s.at(-1);
  const button = element('play');
  button.classList.toggle('playing', clock.playing);
  button.setAttribute('aria-label', clock.playing ? 'Pause' : 'Play');
  const scrub = element('scrub');
  scrub.value = String(clock.time);
  const told = `${clock.time.toFixed(2)} s of ${last.toFixed(2)} s`;
  scrub.setAttribute('aria-valuetext', told);
  scrub.style.setProperty('--done', `${(100 * (clock.time - scrub.min)) / Math.max(scrub.max - scrub.min, 1e-9)}%`);
  element('clock').textContent = told;
}

/** To the frame some frames on; from between two frames, the next one counts as one. */
function stepFrames(replay, clock, frames) {
  const times = replay.about.times_s;
  const { from, to, share } = replay.at(clock.time);
  const here = frames > 0 ? from + Math.floor(share + 1e-6) : to - Math.floor(1 - share + 1e-6);
  clock.playing = false;
  clock.set(times[Math.min(Math.max(here + frames, 0), times.length - 1)]);
}

/** Space and arrows work wherever the reader is, as long as the stage is in sight and no other control wants them. */
function bindKeys(replay, clock) {
  const inSight = () => {
    const { top, bottom } = element('stage').getBoundingClientRect();
    return bottom > 0 && top < innerHeight;
  };
  const actions = {
    ' ': clock.toggle,
    ArrowLeft: (event) => stepFrames(replay, clock, event.shiftKey ? -10 : -1),
    ArrowRight: (event) => stepFrames(replay, clock, event.shiftKey ? 10 : 1),
    Home: () => clock.set(replay.about.times_s[0]),
    End: () => clock.set(replay.about.times_s.at(-1)),
  };
  document.addEventListener('keydown', (event) => {
    const focused = document.activeElement;
    const own = focused === document.body || focused.id === 'stage' || focused.id === 'scrub';
    const action = actions[event.key];
    if (!action || !own || !inSight() || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    action(event);
  });
}

/** Names of containers, gates and arm beside their colours; no colour of what is not there. */
function showRoles({ containers, gates, arm }) {
  const bodies = [...containers, ...gates.map(({ name }) => ({ name, role: 'gate' }))];
  if (arm) bodies.push({ name: arm.name, role: 'arm' });
  document.querySelectorAll('[data-of]').forEach((word) => {
    const role = word.dataset.of;
    const names = bodies.filter((body) => body.role === role).map(({ name }) => name);
    if (!names.length) word.closest('label').remove();
    else if (names.join() !== role) word.textContent += `: ${names.join(', ')}`;
  });
}

function bindSettings(replay, stage, changed) {
  const { about } = replay;
  const colour = (mode) => {
    stage.colourBy(mode);
    showLegend(mode, replay);
    changed();
  };
  element('colours').addEventListener('change', (event) => colour(event.target.value));
  if (about.destinations === null) document.querySelector('[value=destination]').closest('label').remove();
  showRoles(about);
  if (!about.planned.some((pose) => pose)) document.querySelector('[data-planned]').remove();
  colour('speed');
  element('layers').addEventListener('change', (event) => {
    stage.layers[event.target.dataset.layer].visible = event.target.checked;
    changed();
  });
  document.querySelectorAll('[data-view]').forEach((button) => button.addEventListener('click', () => {
    stage.lookFrom(button.dataset.view);
    changed();
  }));
}

/** Wheel and finger scroll the page until the reader has clicked the stage. */
function bindStage(stage, changed) {
  const host = element('stage');
  const zoomable = (on) => () => {
    stage.controls.enableZoom = on;
    stage.canvas.style.touchAction = on ? 'none' : 'pan-y';
  };
  zoomable(false)();
  host.addEventListener('focusin', zoomable(true));
  host.addEventListener('focusout', zoomable(false));
  stage.canvas.addEventListener('pointerdown', () => host.focus({ preventScroll: true }));
  stage.controls.addEventListener('change', changed);
  new ResizeObserver(() => {
    stage.resize();
    changed();
  }).observe(host);
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
    stage.restyle();
    changed();
  });
  addEventListener('beforeprint', () => stage.draw());
}

// ---- Beginning ----

/** Why there can be no replay here; nothing if there can. */
function obstacle() {
  if (typeof DecompressionStream === 'undefined') {
    return 'The replay needs a browser of 2023 or later; curves and tables are complete without it.';
  }
  if (!document.createElement('canvas').getContext('webgl2')) {
    return 'The replay needs WebGL 2, which this browser does not offer; curves and tables are complete without it.';
  }
  return null;
}

function explain(text) {
  element('player').hidden = true;
  const trouble = element('replay-trouble');
  trouble.textContent = text;
  trouble.hidden = false;
}

async function start() {
  element('player').hidden = false;
  const replay = await readReplay();
  const { about } = replay;
  element('replay-title').textContent = `Replay of ${about.name}`;
  const stage = makeStage(await library(), replay, element('stage'));
  const changed = makeLoop((seconds) => {
    clock.pass(seconds);
    stage.show(clock.time);
    stage.draw();
    showTransport(replay, clock);
    return clock.playing;
  });
  const clock = makeClock(about.times_s[0], about.times_s.at(-1), () => changed());
  stage.restyle();
  stage.resize();
  stage.lookFrom('oblique');
  bindTransport(replay, clock, changed);
  bindSettings(replay, stage, changed);
  bindKeys(replay, clock);
  bindStage(stage, changed);
  element('scale').textContent = `floor grid ${Number((1000 * stage.gridStep).toPrecision(3))} mm`;
  element('stage-status').remove();
  changed();
  // For the browser's console, and for tests.
  globalThis.powderline = { replay, stage, clock };
}

const trouble = obstacle();
if (trouble) explain(trouble);
else start().catch((error) => explain(`The replay cannot be shown: ${error.message}.`));
