// Draws round solids with a depth buffer, in plain numbers: it looks the same with and without a graphics card.
// A solid is {from, to, radius, colour}; one of no length is a ball.

const SIDES = 28;
const RINGS = 8; // of half a ball

const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
const unit = (a) => {
  const length = Math.hypot(...a) || 1;
  return [a[0] / length, a[1] / length, a[2] / length];
};

const CIRCLE = Array.from({ length: SIDES }, (_, i) => {
  const angle = (2 * Math.PI * i) / SIDES;
  return [Math.cos(angle), Math.sin(angle)];
});

// Triangles of a solid: corners as [point, normal], in threes.
export function triangles({ from, to, radius }) {
  const way = sub(to, from);
  if (Math.hypot(...way) < 1e-9) return ball(from, radius);
  const axis = unit(way);
  const side = unit(cross(axis, Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
  const other = cross(axis, side);
  const normals = CIRCLE.map(([c, s]) => side.map((value, k) => c * value + s * other[k]));
  const at = (centre, normal) => centre.map((value, k) => value + radius * normal[k]);
  const low = normals.map((normal) => at(from, normal));
  const high = normals.map((normal) => at(to, normal));
  const down = axis.map((value) => -value);
  const found = [];
  for (let i = 0; i < SIDES; i++) {
    const j = (i + 1) % SIDES;
    found.push([low[i], normals[i]], [low[j], normals[j]], [high[j], normals[j]]);
    found.push([low[i], normals[i]], [high[j], normals[j]], [high[i], normals[i]]);
    found.push([to, axis], [high[i], axis], [high[j], axis]);
    found.push([from, down], [low[j], down], [low[i], down]);
  }
  return found;
}

function ball(centre, radius) {
  const found = [];
  const at = (ring, i) => {
    const up = (Math.PI * ring) / (2 * RINGS);
    const [c, s] = CIRCLE[i % SIDES];
    const normal = [c * Math.sin(up), s * Math.sin(up), Math.cos(up)];
    return [centre.map((value, k) => value + radius * normal[k]), normal];
  };
  for (let ring = 0; ring < 2 * RINGS; ring++) {
    for (let i = 0; i < SIDES; i++) {
      found.push(at(ring, i), at(ring + 1, i), at(ring + 1, i + 1));
      found.push(at(ring, i), at(ring + 1, i + 1), at(ring, i + 1));
    }
  }
  return found;
}

// How bright a surface is: 0 to 1 from ambient and direct light, more where it gleams.
function brightness(normal, point, { eye, light }) {
  const look = unit(sub(eye, point));
  const half = unit(look.map((value, k) => value + light[k]));
  const gleam = Math.max(0, dot(normal, half)) ** 32;
  return 0.5 + 0.42 * Math.max(0, dot(normal, light)) + 0.12 * Math.max(0, dot(normal, look)) + 0.4 * gleam;
}

export class Raster {
  // A picture of that many pixels, with a factor by which it is larger than the canvas that it is for.
  constructor(width, height, scale) {
    this.width = width;
    this.height = height;
    this.scale = scale;
    this.image = new ImageData(width, height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.depths = new Float32Array(width * height); // 1 / depth; 0: nothing
  }

  clear() {
    this.pixels.fill(0);
    this.depths.fill(0);
  }

  // Draw a solid as `looking` sees it: {eye, light, project: point -> [x, y, depth]}.
  draw(solid, looking) {
    const corners = triangles(solid);
    const seen = corners.map(([point, normal]) => {
      const [x, y, depth] = looking.project(point);
      return [x * this.scale, y * this.scale, 1 / depth, brightness(normal, point, looking)];
    });
    for (let i = 0; i < seen.length; i += 3) this.fill(seen[i], seen[i + 1], seen[i + 2], solid.colour);
  }

  // Fill a triangle, unless it shows its back; corners are [x, y, 1 / depth, brightness].
  fill(a, b, c, [red, green, blue]) {
    const area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    if (area >= 0) return; // y points down
    const top = Math.max(0, Math.ceil(Math.min(a[1], b[1], c[1]) - 0.5));
    const bottom = Math.min(this.height - 1, Math.floor(Math.max(a[1], b[1], c[1]) - 0.5));
    // Shares of a and b at a pixel, linear in x and y; that of c is what is left.
    const shares = [[b, c], [c, a]].map(([p, r]) => [
      (p[1] - r[1]) / area, (r[0] - p[0]) / area, (p[0] * r[1] - p[1] * r[0]) / area,
    ]);
    const [[ux, uy, u0], [vx, vy, v0]] = shares;
    for (let row = top; row <= bottom; row++) {
      const y = row + 0.5;
      const [u, v] = [u0 + uy * y, v0 + vy * y];
      let [first, last] = [0, this.width];
      for (const [slope, at] of [[ux, u], [vx, v], [-ux - vx, 1 - u - v]]) {
        if (slope > 0) first = Math.max(first, -at / slope);
        else if (slope < 0) last = Math.min(last, -at / slope);
        else if (at < 0) last = -1;
      }
      const end = Math.ceil(last - 0.5);
      for (let column = Math.ceil(first - 0.5); column < end; column++) {
        const x = column + 0.5;
        const [shareA, shareB] = [u + ux * x, v + vx * x];
        const depth = c[2] + shareA * (a[2] - c[2]) + shareB * (b[2] - c[2]);
        const at = row * this.width + column;
        if (depth <= this.depths[at]) continue;
        this.depths[at] = depth;
        const light = c[3] + shareA * (a[3] - c[3]) + shareB * (b[3] - c[3]);
        const shade = Math.min(1, light);
        const gleam = 255 * 0.7 * Math.max(0, light - 1);
        this.pixels[at] =
          0xff000000 |
          (Math.min(255, blue * shade + gleam) << 16) |
          (Math.min(255, green * shade + gleam) << 8) |
          Math.min(255, red * shade + gleam);
      }
    }
  }
}
