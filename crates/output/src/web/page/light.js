// What is made of the light: setups whose lamps can be moved, dimmed, coloured and muted, with undo.

/** Real spherical harmonics up to the second order, as the data was made with. */
function harmonics([x, y, z]) {
  return [
    0.2820948, 0.4886025 * y, 0.4886025 * z, 0.4886025 * x, 1.0925484 * x * y, 1.0925484 * y * z,
    0.31539157 * (3 * z * z - 1), 1.0925484 * x * z, 0.5462742 * (x * x - y * y),
  ];
}

/** The lobes of a list of seven numbers each. */
function lobesOf(numbers) {
  const lobes = [];
  for (let i = 0; i < numbers.length; i += 7) {
    lobes.push({ direction: numbers.slice(i, i + 3), flux: numbers.slice(i + 3, i + 6), spread: numbers[i + 6] });
  }
  return lobes;
}

class Light {
  constructor(setups) {
    // What never changes, by the number of the setup that it comes from.
    this.given = setups.map((setup) => ({
      ...setup,
      lamps: setup.lamps.map((lamp) => ({ ...lamp, lobes: lobesOf(lamp.lobes) })),
      rest: setup.rest.map((rest) => ({ ...rest, lobes: lobesOf(rest.lobes) })),
    }));
    this.state = { active: 0, setups: this.given.map((_, number) => this.fresh(number)) };
    this.undone = [];
    this.before = null;
  }

  fresh(number) {
    const given = this.given[number];
    const lamps = given.lamps.map((lamp) => ({ direction: unit(lamp.direction), stops: 0, gain: [1, 1, 1], muted: lamp.muted }));
    return { given: number, name: given.name, captured: given.captured, ambient: 1, rest: true, lamps };
  }

  get setup() {
    return this.state.setups[this.state.active];
  }

  givenLamp(index) {
    return this.given[this.setup.given].lamps[index];
  }

  hasRest() {
    return this.given[this.setup.given].rest.some((rest) => rest.lobes.length > 0);
  }

  hasAmbient() {
    return Math.max(...this.given[this.setup.given].ambient) > 0;
  }

  /** A lamp's flux as the setup has it, and as it is now. */
  ownFlux(index) {
    return this.givenLamp(index).lobes.reduce((sum, lobe) => add(sum, lobe.flux), [0, 0, 0]);
  }

  flux(index) {
    const lamp = this.setup.lamps[index];
    return this.ownFlux(index).map((own, c) => own * lamp.gain[c] * 2 ** lamp.stops);
  }

  /** Whether a lamp is as the setup has it. */
  isOwn(index) {
    const [lamp, own] = [this.setup.lamps[index], this.fresh(this.setup.given).lamps[index]];
    return JSON.stringify(lamp) === JSON.stringify(own);
  }

  /** Begins a change, which may go on; what is made of the captured light becomes a setup of its own. */
  begin() {
    this.before ??= JSON.stringify(this.state);
    if (this.setup.captured) {
      const made = structuredClone(this.setup);
      made.captured = false;
      for (let number = 1; !made.free; number++) {
        made.name = `Setup ${number}`;
        made.free = this.state.setups.every((setup) => setup.name !== made.name);
      }
      delete made.free;
      this.state.setups.push(made);
      this.state.active = this.state.setups.length - 1;
    }
  }

  /** Ends a change: it is one step for undo. */
  commit() {
    if (this.before !== null && this.before !== JSON.stringify(this.state)) {
      this.undone.push(this.before);
    }
    this.before = null;
  }

  undo() {
    this.commit();
    if (this.undone.length > 0) {
      this.state = JSON.parse(this.undone.pop());
    }
  }

  show(number) {
    this.commit();
    this.state.active = number;
  }

  resetLamp(index) {
    this.begin();
    this.setup.lamps[index] = this.fresh(this.setup.given).lamps[index];
    this.commit();
  }

  /** Gives a lamp the hue of a linear colour and leaves its luminance. */
  setColour(index, wanted) {
    const own = this.ownFlux(index);
    const scale = luminance(own) / Math.max(luminance(wanted), 1e-30);
    this.setup.lamps[index].gain = own.map((v, c) => (v > 0 ? (wanted[c] * scale) / v : 0));
  }

  /** The lobes that shine: direction, flux, spread and the squared distance of near ones. */
  lobes() {
    const given = this.given[this.setup.given];
    const all = [];
    const push = (lobes, near, change) => {
      for (const lobe of lobes) {
        const changed = change(lobe);
        if (Math.max(...changed.flux) > 0) {
          all.push({ ...lobe, ...changed, near: near ?? 0 });
        }
      }
    };
    this.setup.lamps.forEach((lamp, i) => {
      if (lamp.muted) {
        return;
      }
      const from = unit(given.lamps[i].direction);
      push(given.lamps[i].lobes, given.lamps[i].near, (lobe) => ({
        direction: turned(lobe.direction, from, lamp.direction),
        flux: lobe.flux.map((v, c) => v * lamp.gain[c] * 2 ** lamp.stops),
      }));
    });
    if (this.setup.rest) {
      given.rest.forEach((rest) => push(rest.lobes, rest.near, ({ direction, flux }) => ({ direction, flux })));
    }
    return all;
  }

  /** Irradiance by light from everywhere. */
  ambient() {
    return times(this.given[this.setup.given].ambient, this.setup.ambient);
  }

  /** The light's coefficients for what the surface sends to itself: nine harmonics, and light from everywhere. */
  coefficients(lobes) {
    const all = Array.from({ length: 10 }, () => [0, 0, 0]);
    for (const { direction, flux } of lobes) {
      harmonics(direction).forEach((y, k) => (all[k] = add(all[k], times(flux, y))));
    }
    all[9] = times(this.given[this.setup.given].ambientRadiance, this.setup.ambient);
    return all;
  }
}
