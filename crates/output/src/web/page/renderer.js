// The picture: shadows of every lobe, the surface, the mean over pictures, display values.

/** Texels along each side of all shadow tiles together, and numbers of a lobe. */
const SHADOWS = 4096;
const LOBE = 40;
const MOST_LOBES = 256;
/** Pictures whose mean a still picture is. */
const PICTURES = 32;
/** A lamp nearer to the object than this part of its radius casts no shadow. */
const NEAREST = 1.05;
const TURN = 2.3999632;

class Renderer {
  /** Throws a sentence for people where the browser can't do it. */
  constructor(canvas) {
    const options = { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true };
    const gl = canvas.getContext("webgl2", options);
    if (!gl) {
      throw new Error("This page needs WebGL 2, which this browser does not have or has switched off. Try a current Chrome, Edge, "
        + "Firefox or Safari, with graphics acceleration switched on.");
    }
    if (!gl.getExtension("EXT_color_buffer_float")) {
      throw new Error("This page needs a graphics card that draws pictures of floating-point numbers (EXT_color_buffer_float), "
        + "which this one does not. Try another device.");
    }
    this.gl = gl;
    this.canvas = canvas;
    this.drawn = 0;
    this.size = [0, 0];
    this.surface = this.program("surface-vertex", "surface-fragment");
    this.shadow = this.program("shadow-vertex", null);
    this.average = this.program("fullscreen-vertex", "mean-fragment");
    this.display = this.program("fullscreen-vertex", "display-fragment");
    this.nothing = gl.createVertexArray();
    this.makeShadows();
    this.lobes = this.texture(gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, LOBE / 4, MOST_LOBES, 0, gl.RGBA, gl.FLOAT, null);
  }

  program(vertex, fragment) {
    const gl = this.gl;
    const program = gl.createProgram();
    const stages = [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]];
    for (const [kind, id] of stages) {
      const shader = gl.createShader(kind);
      const text = id ? element(id).textContent : "#version 300 es\nvoid main() {}";
      gl.shaderSource(shader, text.trim());
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const said = stages.map((_, i) => gl.getShaderInfoLog(gl.getAttachedShaders(program)[i])).join(" ");
      throw new Error(`This browser's graphics driver does not take the page's shaders: ${said}${gl.getProgramInfoLog(program)}`);
    }
    const places = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const name = gl.getActiveUniform(program, i).name.replace("[0]", "");
      places[name] = gl.getUniformLocation(program, name);
    }
    return { program, places };
  }

  texture(filter) {
    const gl = this.gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, filter);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return texture;
  }

  makeShadows() {
    const gl = this.gl;
    this.shadows = Math.min(SHADOWS, gl.getParameter(gl.MAX_TEXTURE_SIZE));
    this.depths = this.texture(gl.NEAREST);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, this.shadows, this.shadows);
    this.shadowTarget = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowTarget);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.depths, 0);
    // The same depths, compared.
    this.comparing = gl.createSampler();
    for (const [name, value] of [
      [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
      [gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE], [gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL],
    ]) {
      gl.samplerParameteri(this.comparing, name, value);
    }
  }

  /** Takes the object: the page's description with its data unpacked. */
  load(scene, geometry, pictures, transfer) {
    const gl = this.gl;
    this.scene = scene;
    this.vertices = gl.createVertexArray();
    gl.bindVertexArray(this.vertices);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, geometry.numbers, gl.STATIC_DRAW);
    for (const [place, count, offset] of [[0, 3, 0], [1, 2, 8], [2, 2, 12]]) {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, count, gl.UNSIGNED_SHORT, true, 16, offset);
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, geometry.vertices, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(3);
    gl.vertexAttribIPointer(3, 1, gl.UNSIGNED_INT, 4, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, geometry.triangles, gl.STATIC_DRAW);
    this.corners = geometry.triangles.length;
    gl.bindVertexArray(null);
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    const upload = (picture, format) => {
      const texture = this.texture(gl.LINEAR);
      gl.texImage2D(gl.TEXTURE_2D, 0, format, gl.RGBA, gl.UNSIGNED_BYTE, picture);
      return texture;
    };
    this.diffuse = upload(pictures.diffuse, gl.SRGB8_ALPHA8);
    this.albedo = upload(pictures.albedo, gl.SRGB8_ALPHA8);
    this.gloss = pictures.gloss ? upload(pictures.gloss, gl.RGBA8) : this.albedo;
    this.loadTransfer(transfer, scene.geometry.vertices);
  }

  /** Ten texels for each vertex, from lists of one byte for each vertex. */
  loadTransfer(transfer, vertices) {
    const gl = this.gl;
    this.transfer = this.texture(gl.NEAREST);
    if (!transfer) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8_SNORM, 1, 1, 0, gl.RGBA, gl.BYTE, null);
      return;
    }
    const perRow = 400;
    const rows = Math.ceil(vertices / perRow);
    const texels = new Int8Array(4 * 10 * perRow * rows);
    for (let vertex = 0; vertex < vertices; vertex++) {
      for (let k = 0; k < 30; k++) {
        texels[40 * vertex + 4 * Math.floor(k / 3) + (k % 3)] = transfer[k * vertices + vertex];
      }
    }
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8_SNORM, 10 * perRow, rows, 0, gl.RGBA, gl.BYTE, texels);
  }

  /** Pictures of the canvas' size. */
  resize(width, height) {
    if (this.size[0] === width && this.size[1] === height) {
      return;
    }
    const gl = this.gl;
    this.size = [width, height];
    this.canvas.width = width;
    this.canvas.height = height;
    for (const old of this.targets ?? []) {
      gl.deleteTexture(old.texture);
      gl.deleteFramebuffer(old.target);
      gl.deleteRenderbuffer(old.depth);
    }
    this.targets = [0, 1, 2].map((number) => {
      const texture = this.texture(gl.NEAREST);
      gl.texStorage2D(gl.TEXTURE_2D, 1, number === 0 ? gl.RGBA16F : gl.RGBA32F, width, height);
      const target = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
      let depth = null;
      if (number === 0) {
        depth = gl.createRenderbuffer();
        gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
        gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, width, height);
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depth);
      }
      return { texture, target, depth };
    });
    this.restart();
  }

  /** Something else is to be shown. */
  restart() {
    this.drawn = 0;
  }

  /** Takes new light. */
  setLight(light) {
    this.shining = light.lobes().slice(0, MOST_LOBES);
    this.stored = light.setup.captured;
    this.ambient = light.ambient();
    this.coefficients = light.coefficients(this.shining);
    this.lit = false;
    this.restart();
  }

  isSettled() {
    return this.drawn >= PICTURES;
  }

  /** Draws the first picture of a view, or makes the last one better. */
  draw(camera, shown) {
    if (!this.isSettled()) {
      const number = this.drawn;
      if (number > 0 || !this.lit) {
        this.drawShadows(number);
        this.lit = number === 0;
      }
      this.drawSurface(camera, number);
      this.addToMean(number);
      this.drawn++;
    }
    this.show(shown);
  }

  /** Ten texels of four numbers for each lobe: place and spread; flux and squared distance; four columns of the tile's matrix;
   *  softness, half tangent, near and far plane; the tile's place, side and texel; the place that this picture looks at. */
  writeLobes(number) {
    const numbers = new Float32Array(LOBE * MOST_LOBES);
    const tiles = Math.max(1, Math.ceil(Math.sqrt(this.shining.length)));
    const side = Math.floor(this.shadows / tiles);
    this.tiles = this.shining.map((lobe, i) => {
      const radius = 2 * Math.sqrt(lobe.spread);
      const drawn = this.drawnDirection(lobe.direction, radius, number, i);
      const distance = lobe.near;
      const tile = this.tileOf(drawn, radius, distance, side, TURN * (number + i));
      const corner = [(i % tiles) * side, Math.floor(i / tiles) * side];
      const place = distance ? times(lobe.direction, distance) : lobe.direction;
      const sample = distance ? times(drawn, distance) : drawn;
      numbers.set([
        ...place, lobe.spread, ...lobe.flux, distance * distance, ...tile.matrix, ...tile.lens,
        ...corner.map((v) => v / this.shadows), side / this.shadows, tile.texel, ...sample, 0,
      ], LOBE * i);
      return { matrix: tile.lens[0] >= 0 ? tile.matrix : null, corner, side };
    });
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, this.lobes);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, LOBE / 4, MOST_LOBES, gl.RGBA, gl.FLOAT, numbers);
  }

  /** Where in its disc a lobe is looked at: its middle at first, then places spread evenly. */
  drawnDirection(direction, radius, number, lobe) {
    if (number === 0) {
      return direction;
    }
    const [right, up] = across(direction);
    const away = radius * Math.sqrt((number - 0.5) / (PICTURES - 1));
    const angle = TURN * number + lobe;
    return unit(add(direction, add(times(right, away * Math.cos(angle)), times(up, away * Math.sin(angle)))));
  }

  /** How a lobe sees the object, turned about its direction by an angle. */
  tileOf(direction, reach, distance, side, angle) {
    const radius = this.scene.radius;
    const [x, y] = across(direction);
    const right = add(times(x, Math.cos(angle)), times(y, Math.sin(angle)));
    const up = cross(direction, right);
    const softness = Math.tan(Math.min(reach, 1.2));
    if (!distance) {
      const [r, u, d] = [times(right, 1 / radius), times(up, 1 / radius), times(direction, -1 / radius)];
      const matrix = [r[0], u[0], d[0], 0, r[1], u[1], d[1], 0, r[2], u[2], d[2], 0, 0, 0, 0, 1];
      return { matrix, lens: [softness, 0, 0, 0], texel: (2 * radius) / side };
    }
    if (distance < NEAREST * radius) {
      return { matrix: new Array(16).fill(0), lens: [-1, 0, 0, 0], texel: 0 };
    }
    const [near, far] = [distance - radius, distance + radius];
    const halfTangent = radius / Math.sqrt(distance * distance - radius * radius);
    const view = viewFrom(times(direction, distance), right, up, direction);
    const lens = [softness * distance, halfTangent, near, far];
    return { matrix: product(perspective(halfTangent, halfTangent, near, far), view), lens, texel: (2 * far * halfTangent) / side };
  }

  drawShadows(number) {
    const gl = this.gl;
    this.writeLobes(number);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.shadowTarget);
    gl.viewport(0, 0, this.shadows, this.shadows);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    gl.depthMask(true);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1.5, 0);
    this.use(this.shadow);
    gl.bindVertexArray(this.vertices);
    for (const { matrix, corner, side } of this.tiles) {
      if (matrix) {
        gl.viewport(corner[0], corner[1], side, side);
        gl.uniformMatrix4fv(this.shadow.places.clip_from_object, false, matrix);
        gl.drawElements(gl.TRIANGLES, this.corners, gl.UNSIGNED_INT, 0);
      }
    }
    gl.disable(gl.POLYGON_OFFSET_FILL);
  }

  use({ program, places }) {
    const gl = this.gl;
    gl.useProgram(program);
    if (places.low) {
      gl.uniform3fv(places.low, this.scene.geometry.low);
      gl.uniform3fv(places.size, this.scene.geometry.size);
    }
  }

  bind(unit, place, texture, sampler = null) {
    const gl = this.gl;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.bindSampler(unit, sampler);
    gl.uniform1i(place, unit);
  }

  drawSurface(camera, number) {
    const gl = this.gl;
    const [width, height] = this.size;
    const { places } = this.surface;
    const { scene } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.targets[0].target);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.depthMask(true);
    gl.colorMask(true, true, true, true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.use(this.surface);
    gl.uniformMatrix4fv(places.clip_from_object, false, camera.matrix(width, height, placeInPixel(number)));
    gl.uniform3fv(places.eye, camera.eye());
    gl.uniform1i(places.moving, number === 0 ? 1 : 0);
    gl.uniform1i(places.stored, this.stored ? 1 : 0);
    gl.uniform1f(places.texture_scale, this.stored ? scene.textures.diffuse : scene.textures.albedo);
    gl.uniform1i(places.has_gloss, scene.textures.gloss ? 1 : 0);
    gl.uniform4fv(places.gloss_scale, scene.textures.gloss ?? [1, 1, 1, 1]);
    gl.uniform3fv(places.ambient, this.ambient);
    gl.uniform1i(places.model, scene.brdf.model);
    gl.uniform1f(places.main_sigma, scene.brdf.sigma);
    gl.uniform1f(places.main_strength, scene.brdf.strength);
    gl.uniform1i(places.lobe_count, this.shining.length);
    gl.uniform1i(places.has_transfer, scene.transfer ? 1 : 0);
    const scales = scene.transfer?.scales ?? [];
    gl.uniform3fv(places.coefficients, this.coefficients.flatMap((rgb, k) => times(rgb, scales[k] ?? 0)));
    this.bind(0, places.diffuse_texture, this.stored ? this.diffuse : this.albedo);
    this.bind(1, places.gloss_texture, this.gloss);
    this.bind(2, places.shadow_test, this.depths, this.comparing);
    this.bind(3, places.shadow_depths, this.depths);
    this.bind(4, places.lobes, this.lobes);
    this.bind(5, places.transfer, this.transfer);
    gl.bindVertexArray(this.vertices);
    // Depth first, so that only what is seen is shaded.
    gl.depthFunc(gl.LESS);
    gl.colorMask(false, false, false, false);
    gl.drawElements(gl.TRIANGLES, this.corners, gl.UNSIGNED_INT, 0);
    gl.colorMask(true, true, true, true);
    gl.depthFunc(gl.EQUAL);
    gl.drawElements(gl.TRIANGLES, this.corners, gl.UNSIGNED_INT, 0);
  }

  fullscreen() {
    const gl = this.gl;
    gl.disable(gl.DEPTH_TEST);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.enable(gl.DEPTH_TEST);
  }

  addToMean(number) {
    const gl = this.gl;
    const [newest, before, after] = [this.targets[0], this.targets[1 + (number % 2)], this.targets[2 - (number % 2)]];
    gl.bindFramebuffer(gl.FRAMEBUFFER, after.target);
    this.use(this.average);
    this.bind(0, this.average.places.newest, newest.texture);
    this.bind(1, this.average.places.before, before.texture);
    gl.uniform1f(this.average.places.share, 1 / (number + 1));
    this.fullscreen();
    this.mean = after.texture;
  }

  show({ exposure, transform, background }) {
    const gl = this.gl;
    const { places } = this.display;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, ...this.size);
    this.use(this.display);
    this.bind(0, places.picture, this.mean);
    gl.uniform1f(places.exposure, exposure);
    gl.uniform1i(places.transform, transform);
    gl.uniform3fv(places.background, background);
    this.fullscreen();
  }
}

/** Where in a pixel a picture looks, from its middle, in pixels: a sequence with low discrepancy (Roberts 2018). */
function placeInPixel(number) {
  return number === 0 ? [0, 0] : [0.7548776662, 0.569840291].map((step) => ((0.5 + step * number) % 1) - 0.5);
}

/** From the object's space into that of an eye with these axes. */
function viewFrom(eye, right, up, back) {
  return new Float32Array([
    right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, eye), -dot(up, eye), -dot(back, eye), 1,
  ]);
}

/** The projection with these tangents of half the field of view. */
function perspective(horizontal, vertical, near, far) {
  const depth = near - far;
  return new Float32Array([
    1 / horizontal, 0, 0, 0, 0, 1 / vertical, 0, 0, 0, 0, (near + far) / depth, -1, 0, 0, (2 * near * far) / depth, 0,
  ]);
}
