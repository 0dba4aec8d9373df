// Draws round solids with a depth buffer, in plain numbers: it looks the same with and without a graphics card.
// A solid is {from, to, radius, colour}; one of no length is a ball.

const SIDES = 24;
const RINGS = 5; // of half a ball
const GLEAM = 180; // of 255, that is added where a surface is twice as bright as its colour

const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
const unit = (a) => {
  const length = Math.sqrt(dot(a, a)) || 1;
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
function brightness([point, normal], { eye, light }) {
  const look = unit(sub(eye, point));
  const half = unit([look[0] + light[0], look[1] + light[1], look[2] + light[2]]);
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
    for (let i = 0; i < corners.length; i += 3) {
      const three = corners.slice(i, i + 3);
      const [a, b, c] = three.map(([point]) => looking.project(point));
      const area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
      if (area >= 0) continue; // it shows its back: y points down
      const seen = [a, b, c].map(([x, y, depth], k) => [
        x * this.scale, y * this.scale, 1 / depth, brightness(three[k], looking),
      ]);
      this.fill(...seen, area * this.scale ** 2, solid.colour);
    }
  }

  // Fill a triangle; corners are [x, y, 1 / depth, brightness], the area is twice its own.
  fill(a, b, c, area, [red, green, blue]) {
    const top = Math.max(0, Math.ceil(Math.min(a[1], b[1], c[1]) - 0.5));
    const bottom = Math.min(this.height - 1, Math.floor(Math.max(a[1], b[1], c[1]) - 0.5));
    // Shares of a, b and c at a pixel are linear: a0 + ax x + ay y, and so on; so are depth and brightness.
    const [ax, ay, a0] = [(b[1] - c[1]) / area, (c[0] - b[0]) / area, (b[0] * c[1] - b[1] * c[0]) / area];
    const [bx, by, b0] = [(c[1] - a[1]) / area, (a[0] - c[0]) / area, (c[0] * a[1] - c[1] * a[0]) / area];
    const cx = -ax - bx;
    const depthStep = ax * a[2] + bx * b[2] + cx * c[2];
    const lightStep = ax * a[3] + bx * b[3] + cx * c[3];
    const { pixels, depths, width } = this;
    for (let row = top; row <= bottom; row++) {
      const y = row + 0.5;
      const shareA = a0 + ay * y;
      const shareB = b0 + by * y;
      const shareC = 1 - shareA - shareB;
      let first = 0;
      let last = width;
      if (ax > 0) first = Math.max(first, -shareA / ax);
      else if (ax < 0) last = Math.min(last, -shareA / ax);
      else if (shareA < 0) continue;
      if (bx > 0) first = Math.max(first, -shareB / bx);
      else if (bx < 0) last = Math.min(last, -shareB / bx);
      else if (shareB < 0) continue;
      if (cx > 0) first = Math.max(first, -shareC / cx);
      else if (cx < 0) last = Math.min(last, -shareC / cx);
      else if (shareC < 0) continue;
      const begin = Math.ceil(first - 0.5);
      const end = row * width + Math.ceil(last - 0.5);
      const x = begin + 0.5;
      let depth = shareA * a[2] + shareB * b[2] + shareC * c[2] + depthStep * x;
      let light = shareA * a[3] + shareB * b[3] + shareC * c[3] + lightStep * x;
      for (let at = row * width + begin; at < end; at++, depth += depthStep, light += lightStep) {
        if (depth <= depths[at]) continue;
        depths[at] = depth;
        const shade = light < 1 ? light : 1;
        const gleam = light < 1 ? 0 : GLEAM * (light - 1);
        pixels[at] =
          0xff000000 |
          (Math.min(255, blue * shade + gleam) << 16) |
          (Math.min(255, green * shade + gleam) << 8) |
          Math.min(255, red * shade + gleam);
      }
    }
  }
}
