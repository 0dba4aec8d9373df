// Where the links of an arm are, and what they look like, from its Denavit-Hartenberg table.
// Pure: no document, no network. Lengths in m, angles in rad. A transform is twelve numbers, three rows of four.

export const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];

export function compose(a, b) {
  const t = [];
  for (let row = 0; row < 12; row += 4) {
    for (let column = 0; column < 4; column++) {
      t.push(
        a[row] * b[column] + a[row + 1] * b[column + 4] + a[row + 2] * b[column + 8] +
          (column === 3 ? a[row + 3] : 0),
      );
    }
  }
  return t;
}

export function apply(t, [x, y, z]) {
  return [0, 4, 8].map((row) => t[row] * x + t[row + 1] * y + t[row + 2] * z + t[row + 3]);
}

export const origin = (t) => [t[3], t[7], t[11]];

// Transform of a pose: position and rotation vector.
export function fromPose([x, y, z, rx, ry, rz]) {
  const angle = Math.hypot(rx, ry, rz);
  if (angle < 1e-12) return [1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z];
  const [u, v, w] = [rx / angle, ry / angle, rz / angle];
  const [s, c] = [Math.sin(angle), Math.cos(angle)];
  const d = 1 - c;
  return [
    c + u * u * d, u * v * d - w * s, u * w * d + v * s, x,
    u * v * d + w * s, c + v * v * d, v * w * d - u * s, y,
    u * w * d - v * s, v * w * d + u * s, c + w * w * d, z,
  ];
}

// From one Denavit-Hartenberg frame to the next: turn and move along z, then along x.
function step(theta, d, a, alpha) {
  const [s, c] = [Math.sin(theta), Math.cos(theta)];
  const [sa, ca] = [Math.sin(alpha), Math.cos(alpha)];
  return [c, -s * ca, s * sa, a * c, s, c * ca, -c * sa, a * s, 0, sa, ca, d];
}

// The seven frames from the base to the flange.
export function frames(arm, q) {
  const found = [IDENTITY];
  for (let i = 0; i < 6; i++) {
    found.push(compose(found[i], step(q[i], arm.d[i], arm.a[i], arm.alpha[i])));
  }
  return found;
}

export const flange = (arm, q) => frames(arm, q)[6];

const RADII = [0.07, 0.055, 0.048, 0.042, 0.042, 0.04]; // of the links of an arm whose reach is REACH
const REACH = 0.8172;
const HOUSING = 1.2; // of a link's radius, and half its length

// Cylinders {from, to, radius, part}: part "link", "joint" or "tool".
export function shape(arm, q, tool) {
  const size = (Math.abs(arm.a[1]) + Math.abs(arm.a[2])) / REACH;
  const found = frames(arm, q);
  const cylinders = [];
  const add = (from, to, radius, part) => {
    if (Math.hypot(...from.map((value, i) => value - to[i])) > 1e-4) {
      cylinders.push({ from, to, radius, part });
    }
  };
  for (let i = 0; i < 6; i++) {
    const radius = RADII[i] * size;
    const start = origin(found[i]);
    const bend = apply(found[i], [0, 0, arm.d[i]]);
    add(start, bend, radius, "link");
    add(bend, origin(found[i + 1]), radius, "link");
    const half = HOUSING * radius;
    const [low, high] = i === 0 ? [0, half] : [-half, half];
    add(apply(found[i], [0, 0, low]), apply(found[i], [0, 0, high]), half, "joint");
  }
  const tip = origin(compose(found[6], tool));
  add(origin(found[6]), tip, 0.012 * size, "tool");
  return cylinders;
}
