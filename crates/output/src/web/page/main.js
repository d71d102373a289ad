// The page's life: unpacking, the viewpoint, handles, and when to draw.

/** Radians per pixel of dragging; steepest view; field of view across the shorter side, radians. */
const TURNING = 0.008;
const STEEPEST = 1.54;
const FIELD = 0.6;
/** Radius of the handles' sphere in radii of the object. */
const REACH = 1.3;

/** A viewpoint that turns about a point, the horizon level. Positions are relative to the object's centre. */
class Viewpoint {
  constructor({ up, radius, towards }) {
    this.up = unit(up);
    this.radius = radius;
    const axis = Math.abs(this.up[0]) > 0.9 ? [0, 0, 1] : [1, 0, 0];
    this.right = unit(minus(axis, times(this.up, dot(axis, this.up))));
    this.forward = cross(this.right, this.up);
    const back = unit(towards);
    this.first = {
      target: [0, 0, 0],
      turn: Math.atan2(dot(back, this.forward), dot(back, this.right)),
      height: Math.min(Math.max(Math.asin(Math.min(Math.max(dot(back, this.up), -1), 1)), -STEEPEST), STEEPEST),
      // All handles are in sight.
      distance: (1.05 * REACH * radius) / Math.sin(0.5 * FIELD),
    };
    this.reset();
  }

  reset() {
    Object.assign(this, structuredClone(this.first));
  }

  /** Right, up and back. */
  axes() {
    const level = add(times(this.right, Math.cos(this.turn)), times(this.forward, Math.sin(this.turn)));
    const back = add(times(level, Math.cos(this.height)), times(this.up, Math.sin(this.height)));
    const right = unit(cross(this.up, back));
    return [right, cross(back, right), back];
  }

  eye() {
    return add(this.target, times(this.axes()[2], this.distance));
  }

  /** Half the picture's sides at unit distance. */
  tangents(width, height) {
    const per_pixel = Math.tan(0.5 * FIELD) / (0.5 * Math.min(width, height));
    return [0.5 * width * per_pixel, 0.5 * height * per_pixel];
  }

  /** From the object's space to the screen, moved by a part of a pixel. */
  matrix(width, height, [x, y] = [0, 0]) {
    const axes = this.axes();
    const eye = this.eye();
    const away = size(eye);
    const near = Math.max(away - 1.01 * this.radius, 0.005 * this.radius);
    const [horizontal, vertical] = this.tangents(width, height);
    const projection = perspective(horizontal, vertical, near, Math.max(away, near) + 1.01 * this.radius);
    projection[8] = (-2 * x) / width;
    projection[9] = (-2 * y) / height;
    return product(projection, viewFrom(eye, ...axes));
  }

  orbit(x, y) {
    this.turn -= TURNING * x;
    this.height = Math.min(Math.max(this.height + TURNING * y, -STEEPEST), STEEPEST);
  }

  pan(x, y, shorter) {
    const step = (2 * this.distance * Math.tan(0.5 * FIELD)) / shorter;
    const [right, up] = this.axes();
    this.target = add(this.target, add(times(right, -step * x), times(up, step * y)));
  }

  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, 0.02 * this.radius), 100 * this.radius);
  }
}

/** The lights as marks on a sphere around the object. */
class Handles {
  constructor(box, viewpoint, panel) {
    Object.assign(this, { box, viewpoint, panel, held: null });
  }

  sphere() {
    return REACH * this.viewpoint.radius;
  }

  isBehind(direction) {
    return dot(minus(times(direction, this.sphere()), this.viewpoint.eye()), direction) > 0;
  }

  /** Puts a mark where each light is. */
  place() {
    const { light } = this.panel;
    const [width, height] = [this.box.clientWidth, this.box.clientHeight];
    const clip = this.viewpoint.matrix(width, height);
    const lamps = light.setup.lamps;
    const strengths = lamps.map((_, i) => luminance(light.flux(i)));
    const strongest = Math.max(...strengths, 1e-30);
    this.panel.list("handles", lamps, (mark, lamp, index) => {
      const at = [0, 1, 3].map((row) => {
        const place = times(lamp.direction, this.sphere());
        return clip[row] * place[0] + clip[4 + row] * place[1] + clip[8 + row] * place[2] + clip[12 + row];
      });
      const { name } = light.givenLamp(index);
      const behind = this.isBehind(lamp.direction);
      mark.type = "button";
      mark.hidden = at[2] <= 0;
      mark.className = ["handle", (behind || lamp.muted) && "hollow", lamp.muted && "faint", index === this.panel.selected && "selected"]
        .filter(Boolean).join(" ");
      mark.style.left = `${(0.5 + (0.5 * at[0]) / at[2]) * width}px`;
      mark.style.top = `${(0.5 - (0.5 * at[1]) / at[2]) * height}px`;
      mark.style.setProperty("--hue", hexadecimal(light.flux(index)));
      mark.style.setProperty("--size", `${10 + 8 * Math.sqrt(strengths[index] / strongest)}px`);
      mark.setAttribute("aria-label", `${name} handle`);
      mark.title = `${name}${behind ? ", behind the object" : ""}: drag or use the arrow keys to move`;
      this.listen(mark, index);
    }, "button");
  }

  listen(mark, index) {
    if (mark.onpointerdown) {
      return;
    }
    mark.onpointerdown = (event) => {
      event.preventDefault();
      mark.focus();
      mark.setPointerCapture(event.pointerId);
      this.panel.select(index);
      this.held = { index, behind: this.isBehind(this.panel.lamp().direction), outside: false };
    };
    mark.onpointermove = (event) => {
      if (this.held?.index === index) {
        this.follow(event);
      }
    };
    mark.onpointerup = mark.onpointercancel = () => {
      this.held = null;
      this.panel.light.commit();
      this.panel.update();
    };
    mark.onkeydown = (event) => {
      const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (step) {
        event.preventDefault();
        const [right, up] = this.viewpoint.axes();
        const moved = add(times(right, 0.05 * step[0]), times(up, 0.05 * step[1]));
        this.panel.select(index);
        this.panel.edit(() => (this.panel.lamp().direction = unit(add(this.panel.lamp().direction, moved))));
      }
    };
  }

  /** Turns the held light to where the pointer is on its side of the sphere. */
  follow(event) {
    const box = this.box.getBoundingClientRect();
    const [horizontal, vertical] = this.viewpoint.tangents(box.width, box.height);
    const x = ((2 * (event.clientX - box.left)) / box.width - 1) * horizontal;
    const y = (1 - (2 * (event.clientY - box.top)) / box.height) * vertical;
    const [right, up, back] = this.viewpoint.axes();
    const ray = unit(minus(add(times(right, x), times(up, y)), back));
    const eye = this.viewpoint.eye();
    const nearest = add(eye, times(ray, -dot(eye, ray)));
    const room = this.sphere() ** 2 - dot(nearest, nearest);
    const outside = room <= 0;
    if (this.held.outside && !outside) {
      // Once round the edge, to the other side.
      this.held.behind = !this.held.behind;
    }
    this.held.outside = outside;
    const half = outside ? 0 : Math.sqrt(room) * (this.held.behind ? 1 : -1);
    this.panel.light.begin();
    this.panel.lamp().direction = unit(add(nearest, times(ray, half)));
    this.panel.update();
  }
}

/** Mouse and fingers over the picture. */
function listen(canvas, viewpoint, moved) {
  const fingers = new Map();
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus();
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, event);
  });
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return { x: (a.clientX + b.clientX) / 2, y: (a.clientY + b.clientY) / 2, wide: Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY) };
  };
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) {
      return;
    }
    const shorter = Math.min(canvas.clientWidth, canvas.clientHeight);
    if (fingers.size === 2) {
      const before = spread();
      fingers.set(event.pointerId, event);
      const after = spread();
      viewpoint.pan(after.x - before.x, after.y - before.y, shorter);
      viewpoint.zoom(before.wide / Math.max(after.wide, 1));
    } else {
      fingers.set(event.pointerId, event);
      const [x, y] = [event.clientX - last.clientX, event.clientY - last.clientY];
      if (event.shiftKey || event.buttons & 4) {
        viewpoint.pan(x, y, shorter);
      } else {
        viewpoint.orbit(x, y);
      }
    }
    moved();
  });
  const gone = (event) => fingers.delete(event.pointerId);
  canvas.addEventListener("pointerup", gone);
  canvas.addEventListener("pointercancel", gone);
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    viewpoint.zoom(Math.exp(0.0015 * lines * event.deltaY));
    moved();
  }, { passive: false });
}

async function start() {
  const scene = JSON.parse(element("scene").textContent);
  element("name").textContent = scene.name;
  const canvas = element("picture");
  const renderer = new Renderer(canvas);
  if (typeof DecompressionStream === "undefined") {
    throw new Error("This page needs a browser that unpacks data (DecompressionStream): Chrome 80, Firefox 113, Safari 16.4 or later.");
  }
  const largest = renderer.gl.getParameter(renderer.gl.MAX_TEXTURE_SIZE);
  const pictures = {};
  for (const id of ["diffuse", "albedo", "gloss"]) {
    pictures[id] = element(id) && (await unpackPicture(id, largest));
  }
  const transfer = scene.transfer && (await inflated("transfer"));
  renderer.load(scene, await unpackGeometry(scene.geometry), pictures, transfer);
  const viewpoint = new Viewpoint(scene);
  const light = new Light(scene.setups);
  element("panel").hidden = false;
  let waiting = false;
  const later = () => {
    if (!waiting) {
      waiting = true;
      requestAnimationFrame(frame);
    }
  };
  const moved = () => {
    renderer.restart();
    later();
  };
  const panel = new Panel(light, () => {
    renderer.setLight(light);
    later();
  }, later);
  const handles = new Handles(element("handles"), viewpoint, panel);
  function frame() {
    waiting = false;
    const stage = element("stage");
    const density = Math.min(window.devicePixelRatio || 1, 2);
    renderer.resize(Math.max(1, Math.round(stage.clientWidth * density)), Math.max(1, Math.round(stage.clientHeight * density)));
    renderer.draw(viewpoint, panel.shown);
    handles.place();
    if (!renderer.isSettled()) {
      later();
    }
  }
  listen(canvas, viewpoint, moved);
  new ResizeObserver(moved).observe(element("stage"));
  const resetView = () => {
    viewpoint.reset();
    moved();
  };
  element("reset-view").addEventListener("click", resetView);
  const showHandles = () => (element("handles").hidden = !element("show-handles").checked);
  element("show-handles").addEventListener("change", showHandles);
  document.addEventListener("keydown", (event) => {
    const key = event.key.toLowerCase();
    if ((event.ctrlKey || event.metaKey) && key === "z") {
      event.preventDefault();
      panel.undo();
    } else if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("select")) {
      return;
    } else if (key === "r") {
      resetView();
    } else if (key === "h") {
      element("show-handles").click();
    }
  });
  canvas.addEventListener("webglcontextlost", () => {
    element("message").textContent = "The graphics device was lost. Reload the page.";
  });
  element("message").textContent = "";
  later();
  // For scripts: the view as a frame of a transforms.json has it, and whether the picture is final.
  window.rekindle = {
    camera() {
      const [width, height] = renderer.size;
      const axes = viewpoint.axes();
      const eye = add(viewpoint.eye(), scene.origin);
      const rows = [0, 1, 2].map((k) => [axes[0][k], axes[1][k], axes[2][k], eye[k]]);
      const focal = 0.5 * Math.min(width, height) / Math.tan(0.5 * FIELD);
      return { w: width, h: height, fl_x: focal, fl_y: focal, cx: width / 2, cy: height / 2, transform_matrix: [...rows, [0, 0, 0, 1]] };
    },
    isSettled: () => renderer.isSettled(),
  };
}

start().catch((error) => {
  element("message").textContent = error.message;
});
