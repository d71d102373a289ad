// Vectors as lists of numbers, matrices column by column.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const times = (a, factor) => [a[0] * factor, a[1] * factor, a[2] * factor];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const size = (a) => Math.hypot(a[0], a[1], a[2]);

/** The unit vector of a direction, or another where it has none. */
function unit(a, otherwise = [0, 1, 0]) {
  const length = size(a);
  return length > 1e-12 ? times(a, 1 / length) : otherwise;
}

/** Two unit vectors that span the plane across a unit vector. */
function across(direction) {
  const axis = Math.abs(direction[0]) < 0.6 ? [1, 0, 0] : [0, 1, 0];
  const right = unit(cross(axis, direction));
  return [right, cross(direction, right)];
}

/** Turns a vector by the smallest rotation that takes one unit vector to another. */
function turned(vector, from, to) {
  const axis = cross(from, to);
  const cosine = dot(from, to);
  if (cosine < -0.999999) {
    // By half a turn about any axis across.
    const [pole] = across(from);
    return minus(times(pole, 2 * dot(pole, vector)), vector);
  }
  const along = times(axis, dot(axis, vector) / (1 + cosine));
  return add(add(times(vector, cosine), cross(axis, vector)), along);
}

/** The product of two matrices of four columns. */
function product(a, b) {
  const c = new Float32Array(16);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      for (let k = 0; k < 4; k++) {
        c[4 * column + row] += a[4 * k + row] * b[4 * column + k];
      }
    }
  }
  return c;
}

/** Luminance of a linear Rec. 709 colour. */
const luminance = (rgb) => 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];

/** A display value of a linear one, and back. */
const encoded = (v) => (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);
const decoded = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);

/** A linear colour, its largest channel taken for white, as `#rrggbb`. */
function hexadecimal(rgb) {
  const most = Math.max(...rgb, 1e-30);
  const byte = (v) => Math.round(255 * encoded(Math.min(Math.max(v / most, 0), 1)));
  return "#" + rgb.map((v) => byte(v).toString(16).padStart(2, "0")).join("");
}

/** The linear colour of `#rrggbb`. */
const colourOf = (text) => [1, 3, 5].map((at) => decoded(parseInt(text.slice(at, at + 2), 16) / 255));
