// Where the links of a chain are, and what they look like.
// Pure: no document, no network. Lengths in m, angles in rad. A transform is twelve numbers, three rows of four.
// A chain is {joints, slides, tip}: the transform from each link to the axis (z) of the next joint, whether that slides
// along it (not, where there is no `slides`), and the transform to the flange.

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

const turn = (q) => [Math.cos(q), -Math.sin(q), 0, 0, Math.sin(q), Math.cos(q), 0, 0, 0, 0, 1, 0];

const slide = (q) => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, q];

// The frame of each link, behind its joint, and that of the flange.
export function frames(chain, q, place = IDENTITY) {
  const found = [];
  let before = place;
  chain.joints.forEach((joint, i) => {
    before = compose(compose(before, joint), chain.slides?.[i] ? slide(q[i]) : turn(q[i]));
    found.push(before);
  });
  found.push(compose(before, chain.tip));
  return found;
}

export const flange = (chain, q) => frames(chain, q).at(-1);

const length = (t) => Math.hypot(...origin(t));

// Length of the stretched arm, from the second joint on.
export const reach = (chain) =>
  Math.max(0.1, chain.joints.slice(2).reduce((sum, joint) => sum + length(joint), length(chain.tip)));

const THICK = 0.062; // radius of the first link, and of the last, of an arm of that reach
const THIN = 0.036;
const REACH = 1.0;
const HOUSING = 1.18; // of a link's radius, and half its length

// Cylinders {from, to, radius, part}: part "base", "link", "elbow" (a ball at `to`), "joint", "cap" or "tool".
// Each link runs along the axis of its joint, then straight to the next one. `tip` is where the tool is.
export function shape(chain, q, place, tip) {
  const size = reach(chain) / REACH;
  const found = frames(chain, q, place);
  const cylinders = [];
  const add = (from, to, radius, part) => {
    if (part === "elbow" || Math.hypot(...from.map((value, i) => value - to[i])) > 1e-4) {
      cylinders.push({ from, to, radius, part });
    }
  };
  const last = chain.joints.length - 1;
  chain.joints.forEach((_, i) => {
    const radius = (THICK + ((THIN - THICK) * i) / Math.max(1, last)) * size;
    const next = chain.joints[i + 1] ?? chain.tip;
    const start = origin(found[i]);
    const bend = apply(found[i], [0, 0, next[11]]);
    const end = apply(found[i], origin(next));
    add(start, bend, radius, "link");
    add(bend, bend, radius, "elbow");
    add(bend, end, radius, "link");
    const half = HOUSING * radius;
    const along = (z) => apply(found[i], [0, 0, z]);
    if (chain.slides?.[i]) {
      add(i ? origin(found[i - 1]) : origin(place), start, 0.7 * radius, "cap");
      add(along(-half), along(half), half, "joint");
    } else if (i === 0) {
      add(along(0), along(0.2 * half), 1.5 * half, "base");
      add(along(0.2 * half), along(1.1 * half), half, "joint");
    } else {
      add(along(-half), along(half), half, "joint");
      add(along(-1.14 * half), along(-half), 0.86 * half, "cap");
      add(along(half), along(1.14 * half), 0.86 * half, "cap");
    }
  });
  const flangeAt = found.at(-1);
  add(origin(flangeAt), origin(tip), 0.012 * size, "tool");
  return cylinders;
}
