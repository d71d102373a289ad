// View transforms: the twin of `studio/view_transform.rs`, where the formulas' sources are named.

fn srgb_encode(linear: vec3f) -> vec3f {
    let c = clamp(linear, vec3f(0.0), vec3f(1.0));
    return select(1.055 * pow(c, vec3f(1.0 / 2.4)) - 0.055, 12.92 * c, c <= vec3f(0.0031308));
}

fn agx(linear: vec3f) -> vec3f {
    let to_rec2020 = mat3x3f(0.6274, 0.0691, 0.0164, 0.3293, 0.9195, 0.0880, 0.0433, 0.0113, 0.8956);
    let from_rec2020 = mat3x3f(1.6605, -0.1246, -0.0182, -0.5876, 1.1329, -0.1006, -0.0728, -0.0083, 1.1187);
    let inset = mat3x3f(0.856627153315983, 0.137318972929847, 0.11189821299995, 0.0951212405381588,
        0.761241990602591, 0.0767994186031903, 0.0482516061458583, 0.101439036467562, 0.811302368396859);
    let outset = mat3x3f(1.1271005818144368, -0.1413297634984383, -0.14132976349843826, -0.11060664309660323,
        1.157823702216272, -0.11060664309660294, -0.016493938717834573, -0.016493938717834257, 1.2519364065950405);
    let stops = log2(max(inset * (to_rec2020 * linear), vec3f(1e-10)));
    let x = clamp((stops + 12.47393) / (4.026069 + 12.47393), vec3f(0.0), vec3f(1.0));
    let x2 = x * x;
    let x4 = x2 * x2;
    let curve = 15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x - 0.00232;
    return from_rec2020 * pow(max(outset * curve, vec3f(0.0)), vec3f(2.2));
}

fn aces(linear: vec3f) -> vec3f {
    let input = mat3x3f(0.59719, 0.07600, 0.02840, 0.35458, 0.90834, 0.13383, 0.04823, 0.01566, 0.83777);
    let output = mat3x3f(1.60475, -0.10208, -0.00327, -0.53108, 1.10813, -0.07276, -0.07367, -0.00605, 1.07602);
    // Past this the curve is flat, and its square would leave the range of numbers.
    let v = input * min(linear, vec3f(1e15));
    return output * ((v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081));
}

fn pbr_neutral(linear: vec3f) -> vec3f {
    let start = 0.8 - 0.04;
    let least = min(linear.r, min(linear.g, linear.b));
    let offset = select(0.04, least - 6.25 * least * least, least < 0.08);
    let colour = linear - offset;
    let peak = max(colour.r, max(colour.g, colour.b));
    if (peak < start) {
        return colour;
    }
    let room = 1.0 - start;
    let new_peak = 1.0 - room * room / (peak + room - start);
    let grey = 1.0 - 1.0 / (0.15 * (peak - new_peak) + 1.0);
    return mix(colour * (new_peak / peak), vec3f(new_peak), grey);
}

fn turbo(t_: f32) -> vec3f {
    let t = clamp(t_, 0.0, 1.0);
    var sum = vec3f(59.28637943, 2.82956604, 27.34824973);
    sum = sum * t + vec3f(-152.94239396, 4.27729857, -89.90310912);
    sum = sum * t + vec3f(132.13108234, -14.18503333, 110.36276771);
    sum = sum * t + vec3f(-42.66032258, 4.84296658, -60.58204836);
    sum = sum * t + vec3f(4.61539260, 2.19418839, 12.64194608);
    sum = sum * t + vec3f(0.13572138, 0.09140261, 0.10667330);
    return clamp(sum, vec3f(0.0), vec3f(1.0));
}

fn false_colour(linear: vec3f) -> vec3f {
    return turbo(log2(dot(linear, vec3f(0.2126, 0.7152, 0.0722)) + 1.0 / 32.0) / 10.0 + 0.5);
}

/// Display values, sRGB-encoded, of linear colour. The order is that of `ViewTransform::ALL`.
fn view_transform(transform: u32, linear_: vec3f) -> vec3f {
    let linear = max(linear_, vec3f(0.0));
    switch transform {
        case 1u: { return srgb_encode(agx(linear)); }
        case 2u: { return srgb_encode(aces(linear)); }
        case 3u: { return srgb_encode(pbr_neutral(linear)); }
        case 4u: { return false_colour(linear); }
        default: { return srgb_encode(linear); }
    }
}
