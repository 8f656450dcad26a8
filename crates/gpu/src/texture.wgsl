// Texture of mucosa: the operations of crates/raycast/src/packet/texture.rs.

fn stir(x: i32) -> i32 {
    return x * (x + x + 1);
}

// Return a pseudo-random number from -1 to 1 for a corner of the noise lattice.
fn random(sum: i32) -> f32 {
    return f32(stir(stir(sum) + STIR)) * (1.0 / 2147483648.0);
}

// Return lattice noise, from -1 to 1, and its gradient.
fn noise(q: vec3<f32>, seed: i32) -> vec4<f32> {
    let low_corner = floor(q);
    let x = q - low_corner;
    let low = (vec3<i32>(low_corner) + seed) * PRIMES;
    let high = low + PRIMES;
    let inner = fma(x, fma(x, vec3<f32>(BLEND.x), vec3<f32>(BLEND.y)), vec3<f32>(BLEND.z));
    let t = x * x * x * inner;
    let y = x * (x - 1.0);
    let slope = 30.0 * (y * y);
    let a00 = random(low.x + low.y + low.z);
    let a10 = random(low.x + high.y + low.z);
    let a01 = random(low.x + low.y + high.z);
    let a11 = random(low.x + high.y + high.z);
    let d00 = random(high.x + low.y + low.z) - a00;
    let d10 = random(high.x + high.y + low.z) - a10;
    let d01 = random(high.x + low.y + high.z) - a01;
    let d11 = random(high.x + high.y + high.z) - a11;
    let v00 = fma(t.x, d00, a00);
    let v10 = fma(t.x, d10, a10);
    let v01 = fma(t.x, d01, a01);
    let v11 = fma(t.x, d11, a11);
    let near = lerp(t.y, v00, v10);
    let far = lerp(t.y, v01, v11);
    let dx = lerp(t.z, lerp(t.y, d00, d10), lerp(t.y, d01, d11));
    let dy = lerp(t.z, v10 - v00, v11 - v01);
    return vec4<f32>(lerp(t.z, near, far), slope * vec3<f32>(dx, dy, far - near));
}

struct Skin {
    tint: vec3<f32>,
    relief: vec3<f32>,
    film: f32,
    mottle: f32,
    // Value and gradient of the noise of the wrinkles.
    bumps: vec4<f32>,
}

fn to_lattice(v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot_of(ASKEW[0], v), dot_of(ASKEW[1], v), dot_of(ASKEW[2], v));
}

fn from_lattice(v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        dot_of(vec3<f32>(ASKEW[0].x, ASKEW[1].x, ASKEW[2].x), v),
        dot_of(vec3<f32>(ASKEW[0].y, ASKEW[1].y, ASKEW[2].y), v),
        dot_of(vec3<f32>(ASKEW[0].z, ASKEW[1].z, ASKEW[2].z), v),
    );
}

fn sharpness(footprint_mm: f32, per_mm: f32) -> f32 {
    return ramp(footprint_mm * per_mm, SHARP);
}

// Return the coverage by a line that follows the zeros of a noise.
fn line_at(web: f32, steep_per_mm: f32, half_mm: f32, footprint_mm: f32) -> f32 {
    let off_mm = abs(web) / max(steep_per_mm, LEAST_STEEP);
    let width = max(half_mm, footprint_mm * LEAST_VESSEL_PX);
    let per_width = 1.0 / width;
    return smoothed(1.0 - off_mm * per_width) * (half_mm * per_width);
}

fn vessel(mottle: vec4<f32>, wrinkle: vec4<f32>, footprint_mm: f32) -> f32 {
    let bend_steep = sqrt(dot_of(mottle.yzw, mottle.yzw));
    let fold_steep = sqrt(dot_of(wrinkle.yzw, wrinkle.yzw));
    var stem = line_at(mottle.x, bend_steep * MOTTLE_PER_MM, VESSEL_MM, footprint_mm);
    stem *= ramp(bend_steep, STEMS);
    let taper = fma(mottle.x, TAPER.x, TAPER.y);
    let half = max(taper, TAPER.z) * BRANCH_MM;
    var branch = line_at(wrinkle.x, fold_steep * WRINKLES_PER_MM, half, footprint_mm);
    branch *= ramp(fold_steep, BRANCHES);
    let beside = smoothed(mottle.x * BESIDE_STEM) * smoothed(taper + taper);
    return max(stem, branch * beside) * ramp(mottle.y, SHOWN);
}

fn skin_at(lps: vec3<f32>, footprint_mm: f32) -> Skin {
    let q = to_lattice(lps);
    let mottled = noise(q * MOTTLE_PER_MM, SKIN_SEEDS.x);
    let grain = noise(q * RELIEF_PER_MM, SKIN_SEEDS.y);
    let wrinkle = noise(q * WRINKLES_PER_MM, SKIN_SEEDS.z);
    let mottle = mottled.x * light.texture;
    var vessels = 0.0;
    if light.vessels > 0.0 {
        vessels = vessel(mottled, wrinkle, footprint_mm) * light.vessels;
    }
    var skin: Skin;
    skin.tint = vec3<f32>(
        fma(mottle, SKIN_TINT[0].x, fma(vessels, SKIN_TINT[0].y, 1.0)),
        fma(mottle, SKIN_TINT[1].x, fma(vessels, SKIN_TINT[1].y, 1.0)),
        fma(mottle, SKIN_TINT[2].x, fma(vessels, SKIN_TINT[2].y, 1.0)),
    );
    let fine = sharpness(footprint_mm, RELIEF_PER_MM) * (RELIEF * light.texture);
    let wide = sharpness(footprint_mm, WRINKLES_PER_MM) * (RELIEF * light.texture);
    skin.relief = from_lattice(fma(grain.yzw, vec3<f32>(fine), wrinkle.yzw * wide));
    let film = fma(grain.x * fine, FILM_FROM.x, fma(mottle, FILM_FROM.y, FILM_FROM.z));
    skin.film = clamp(film, 0.0, 1.0);
    skin.mottle = mottled.x;
    skin.bumps = wrinkle;
    return skin;
}
