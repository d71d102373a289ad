// The page's data as lists of numbers and pictures.

const element = (id) => document.getElementById(id);

function bytesOf(id) {
  const text = atob(element(id).textContent);
  element(id).textContent = "";
  return Uint8Array.from(text, (character) => character.charCodeAt(0));
}

async function inflated(id) {
  const stream = new Blob([bytesOf(id)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Numbers from differences, whose bytes come first all low, then all next ones; so many numbers from a place in the list. */
function undone(bytes, start, count, width) {
  const numbers = width === 2 ? new Uint16Array(count) : new Uint32Array(count);
  let before = 0;
  for (let i = 0; i < count; i++) {
    let step = 0;
    for (let byte = 0; byte < width; byte++) {
      step |= bytes[start + byte * count + i] << (8 * byte);
    }
    before += (step >>> 1) ^ -(step & 1);
    numbers[i] = before;
    before = numbers[i];
  }
  return numbers;
}

/** What the surface needs on the device: per corner its place, normal, texture coordinates and vertex; and the triangles. */
async function unpackGeometry(about) {
  const { vertices, corners, triangles } = about;
  const packed = await inflated("vertices");
  const own = [0, 1, 2, 3, 4].map((k) => undone(packed, 2 * k * vertices, vertices, 2));
  const ofCorner = undone(await inflated("corner-vertices"), 0, corners, 4);
  const uvs = await inflated("corner-uvs");
  const [u, v] = [0, 1].map((k) => undone(uvs, 2 * k * corners, corners, 2));
  const numbers = new Uint16Array(8 * corners);
  for (let i = 0; i < corners; i++) {
    const vertex = ofCorner[i];
    for (let k = 0; k < 3; k++) {
      numbers[8 * i + k] = own[k][vertex];
    }
    numbers.set([own[3][vertex], own[4][vertex], u[i], v[i]], 8 * i + 4);
  }
  return { numbers, vertices: ofCorner, triangles: undone(await inflated("triangles"), 0, 3 * triangles, 4) };
}

/** A picture as it is stored: no colour profile, no alpha; smaller where the device has no such large ones. */
async function unpackPicture(id, largest) {
  const file = new Blob([bytesOf(id)], { type: element(id).type });
  const plain = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
  const picture = await createImageBitmap(file, plain);
  const side = Math.max(picture.width, picture.height);
  if (side <= largest) {
    return picture;
  }
  const scaled = (length) => Math.max(1, Math.floor((length * largest) / side));
  const size = { resizeWidth: scaled(picture.width), resizeHeight: scaled(picture.height), resizeQuality: "high" };
  return createImageBitmap(picture, { ...plain, ...size });
}
