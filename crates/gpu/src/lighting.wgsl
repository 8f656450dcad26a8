// Shading of first walls on a GPU: the operations of crates/raycast (packet/lighting.rs, slopes.rs, texture.rs, rings.rs,
// film.rs, mist.rs, exposure.rs, silhouette.rs). The constants in capitals come from that crate (shader.rs).

// Parameters of the shading, with the memory layout of `LightUniforms` in light_uniforms.rs.
struct Lighting {
    // Positions of the light guides relative to the camera's centre, LPS mm.
    guide_a: vec4<f32>,
    guide_b: vec4<f32>,
    camera_lps: vec4<f32>,
    lps_from_ijk: array<vec4<f32>, 3>,
    ijk_from_lps: array<vec4<f32>, 3>,
    camera_from_lps: array<vec4<f32>, 3>,
    // Rows of the matrix from slopes to inward normals.
    inward: array<vec4<f32>, 3>,
    // Distance of a slope's samples from the voxel, in voxels.
    reach: vec4<f32>,
    // Limits of the samples of a slope, then limits of the HU values of pale tissue.
    held: vec4<f32>,
    // Number of bricks of the volume along each axis, and capacity of the store of bricks.
    num_bricks: vec4<u32>,
    // Decoration: number of cells along each axis; position of the first cell and number of cells per mm.
    cells_shape: vec4<i32>,
    cells_origin: vec4<f32>,
    // Exposure that the appearance gives; negative for an automatic exposure.
    exposure: f32,
    ambient: f32,
    wrap: f32,
    gloss: f32,
    paleness: f32,
    texture: f32,
    vessels: f32,
    specks: f32,
    secretions: f32,
    fog: f32,
    rings: f32,
    membrane: f32,
    hue: f32,
    spurs: f32,
    pixel_mm: f32,
    slope_scale: f32,
    slope_unit: f32,
    shininess_log2: u32,
    has_decoration: u32,
    // First entry of the list of silhouettes that a dispatch smooths, and the number of its entries.
    first_marked: u32,
    most_marked: u32,
    unused_a: u32,
    unused_b: u32,
    unused_c: u32,
}

// Store of bricks: slopes at the voxels of cubes of cells, which all pictures of a volume share.
struct Bricks {
    // Number of bricks that pictures have requested; the store has fewer if it is full.
    requested: atomic<u32>,
    // Number of bricks that are filled.
    filled: atomic<u32>,
    unused_a: u32,
    unused_b: u32,
    // For each brick of the volume one more than its index in the store, 0 for none, or BUSY.
    entries: array<atomic<u32>>,
}

// Results that the stages of a picture pass on.
struct State {
    exposure: f32,
    num_lit: atomic<u32>,
    num_marked: atomic<u32>,
    unused: u32,
    // Light that the walls of the metered rays reflect.
    metered: array<f32, 144>,
    // Pixels on silhouettes, as indices in `pixels`.
    marked: array<u32>,
}

@group(0) @binding(8) var<uniform> light: Lighting;
@group(0) @binding(9) var<storage, read> cells: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> bricks: Bricks;
// Slopes of the stored bricks, two words per voxel: x and y, z and a mark. The last word of a brick is its number.
@group(0) @binding(11) var<storage, read_write> slopes: array<u32>;
// Depths of the first walls of the picture, in steps.
@group(0) @binding(12) var<storage, read_write> depths: array<f32>;
@group(0) @binding(13) var<storage, read_write> state: State;

const_assert METERED * METERED == 144u;

// Entry of a brick whose index is being assigned.
const BUSY: u32 = 0xffffffffu;
// Number of 32-bit words of a brick and of a voxel in it, and number of voxels of a brick along each axis.
const BRICK_WORDS: u32 = PER_BRICK / 2u;
const VOXEL_WORDS: u32 = PER_VOXEL / 2u;
const BRICK_VOXELS: u32 = CELLS + 1u;
// Inverse depth of a pixel without a ray, which is on no silhouette.
const NO_RAY: f32 = -1.0;

struct Wall {
    delta: vec3<f32>,
    // Distance in steps; 0 for a ray without a wall.
    hit: f32,
    transparency: f32,
    albedo: vec3<f32>,
}

fn dot_of(u: vec3<f32>, v: vec3<f32>) -> f32 {
    return fma(u.z, v.z, fma(u.y, v.y, u.x * v.x));
}

fn turned(rows: array<vec4<f32>, 3>, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot_of(rows[0].xyz, v), dot_of(rows[1].xyz, v), dot_of(rows[2].xyz, v));
}

fn along(p: vec3<f32>, t: f32, v: vec3<f32>) -> vec3<f32> {
    return fma(vec3<f32>(t), v, p);
}

fn unit(v: vec3<f32>) -> vec3<f32> {
    return v * (1.0 / max(sqrt(dot_of(v, v)), 1e-12));
}

fn smoothed(v: f32) -> f32 {
    let t = clamp(v, 0.0, 1.0);
    return t * t * fma(t, -2.0, 3.0);
}

// Return a smooth step of a linear function with slope and offset `line`.
fn ramp(v: f32, line: vec2<f32>) -> f32 {
    return smoothed(fma(v, line.x, line.y));
}

// --- Slopes -----------------------------------------------------------------------------------------------------------

fn held_value(p: vec3<i32>) -> f32 {
    let v = clamp(p, vec3<i32>(0), frame.last.xyz);
    return clamp(f32(voxel(v.x, v.y, v.z)), light.held.x, light.held.y);
}

fn between(a: f32, b: f32, rest: f32) -> f32 {
    return a + rest * (b - a);
}

// Return the whole numbers of the slope at a voxel, which may be one beyond the volume.
fn slope_of(v: vec3<i32>) -> vec3<i32> {
    let near = CORNER_AT * light.reach.xyz;
    let whole = vec3<i32>(near);
    let rest = near - vec3<f32>(whole);
    var corners = vec3<f32>(0.0);
    for (var c = 0u; c < 8u; c++) {
        let side = vec3<i32>(i32(2u * (c & 1u)), i32(c & 2u), i32((c & 4u) / 2u)) - 1;
        let a = v + side * whole;
        let b = a + side;
        let r00 = between(held_value(a), held_value(vec3<i32>(b.x, a.y, a.z)), rest.x);
        let r10 = between(held_value(vec3<i32>(a.x, b.y, a.z)), held_value(vec3<i32>(b.x, b.y, a.z)), rest.x);
        let r01 = between(held_value(vec3<i32>(a.x, a.y, b.z)), held_value(vec3<i32>(b.x, a.y, b.z)), rest.x);
        let r11 = between(held_value(vec3<i32>(a.x, b.y, b.z)), held_value(b), rest.x);
        corners += vec3<f32>(side) * between(between(r00, r10, rest.y), between(r01, r11, rest.y), rest.z);
    }
    let far = AXIS_AT * light.reach.xyz;
    let far_whole = vec3<i32>(far);
    let far_rest = far - vec3<f32>(far_whole);
    var axes = vec3<f32>(0.0);
    for (var a = 0; a < 3; a++) {
        var one = vec3<i32>(0);
        one[a] = 1;
        let out = one * far_whole[a];
        let after = between(held_value(v + out), held_value(v + out + one), far_rest[a]);
        let before = between(held_value(v - out), held_value(v - out - one), far_rest[a]);
        axes[a] = after - before;
    }
    let scaled = (AXIS_WEIGHT * axes + CORNER_WEIGHT * corners) * light.slope_scale;
    return vec3<i32>(sign(scaled) * floor(abs(scaled) + 0.5));
}

fn brick_number(cell: vec3<i32>) -> u32 {
    let b = vec3<u32>(cell) / CELLS;
    return (b.z * light.num_bricks.y + b.y) * light.num_bricks.x + b.x;
}

// Return the slope at a voxel of a stored brick, and 1 if the brick was filled.
fn stored_slope(word: u32) -> vec4<i32> {
    let xy = slopes[word];
    let z = slopes[word + 1u];
    return vec4<i32>(i32(xy << 16u) >> 16u, i32(xy) >> 16u, i32(z << 16u) >> 16u, i32(z >> 16u));
}

// Return the slopes round a position in voxels, interpolated between voxels.
fn rise(p: vec3<f32>) -> vec3<f32> {
    let cell = cell_of(p);
    let entry = atomicLoad(&bricks.entries[brick_number(cell.ijk)]);
    var at: array<vec4<i32>, 8>;
    var filled = entry > 0u && entry <= light.num_bricks.w;
    if filled {
        let local = vec3<u32>(cell.ijk) % CELLS;
        let base = (entry - 1u) * BRICK_WORDS;
        for (var c = 0u; c < 8u; c++) {
            let v = local + vec3<u32>(c & 1u, c >> 1u & 1u, c >> 2u);
            at[c] = stored_slope(base + VOXEL_WORDS * ((v.z * BRICK_VOXELS + v.y) * BRICK_VOXELS + v.x));
            filled = filled && at[c].w == 1;
        }
    }
    if !filled {
        for (var c = 0u; c < 8u; c++) {
            let v = cell.ijk + vec3<i32>(vec3<u32>(c & 1u, c >> 1u & 1u, c >> 2u));
            at[c] = vec4<i32>(slope_of(v), 1);
        }
    }
    let t = cell.t;
    var slope = vec3<f32>(0.0);
    for (var a = 0; a < 3; a++) {
        let low = lerp(t.y, lerp_ints(t.x, at[0][a], at[1][a]), lerp_ints(t.x, at[2][a], at[3][a]));
        let high = lerp(t.y, lerp_ints(t.x, at[4][a], at[5][a]), lerp_ints(t.x, at[6][a], at[7][a]));
        slope[a] = lerp(t.z, low, high) * light.slope_unit;
    }
    return slope;
}

// --- Texture ----------------------------------------------------------------------------------------------------------

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

// --- Decoration from the airway tree ----------------------------------------------------------------------------------

struct Anatomy {
    inside: bool,
    phase: f32,
    growth: vec3<f32>,
    across: vec2<f32>,
    rings: f32,
    proximal: f32,
    spur: f32,
    membrane: f32,
    regular: f32,
}

// Interpolate the decoration's grid in one of six tetrahedra of a cell.
fn anatomy_at(lps: vec3<f32>) -> Anatomy {
    var found: Anatomy;
    let last = light.cells_shape.xyz - 1;
    let q = (lps - light.cells_origin.xyz) * light.cells_origin.w;
    found.inside = all(q > vec3<f32>(0.0)) && all(q < vec3<f32>(last));
    if !found.inside {
        return found;
    }
    let cell = min(vec3<i32>(floor(q)), last - 1);
    let t = q - vec3<f32>(cell);
    let n = light.cells_shape;
    let base = 2 * ((cell.z * n.y + cell.y) * n.x + cell.x);
    let step = vec3<i32>(2, 2 * n.x, 2 * n.x * n.y);
    let x_y = t.x < t.y;
    let x_z = t.x < t.z;
    let y_z = t.y < t.z;
    let y_first = x_y && !y_z;
    let z_first = x_z && y_z;
    let x_last = x_y && x_z;
    let y_last = y_z && !x_y;
    let first = select(select(step.x, step.y, y_first), step.z, z_first);
    let final_step = select(select(step.z, step.y, y_last), step.x, x_last);
    let whole = step.x + step.y + step.z;
    var corners = array<i32, 4>(base, base + first, base + (whole - final_step), base + whole);
    let low = min(t.x, t.y);
    let high = max(t.x, t.y);
    let most = max(high, t.z);
    let least = min(low, t.z);
    let middle = max(low, min(high, t.z));
    let weights = vec4<f32>(1.0 - most, most - middle, middle - least, least);
    var one = vec4<f32>(0.0);
    var two = vec4<f32>(0.0);
    var phases = vec4<f32>(0.0);
    for (var c = 0; c < 4; c++) {
        let entry = cells[corners[c]];
        one = fma(vec4<f32>(weights[c]), entry, one);
        two = fma(vec4<f32>(weights[c]), cells[corners[c] + 1], two);
        phases[c] = entry.x;
    }
    let way = phases.yzw - phases.xyz;
    let slope = vec3<f32>(
        select(select(way.x, way.y, y_first || z_first), way.z, x_last),
        select(select(way.y, way.z, y_last), way.x, y_first),
        select(select(way.z, way.y, x_last || y_last), way.x, z_first),
    );
    found.phase = one.x;
    found.growth = slope * light.cells_origin.w;
    found.across = one.yz;
    found.rings = one.w;
    found.proximal = two.x;
    found.spur = two.y;
    found.membrane = two.z;
    found.regular = two.w;
    return found;
}

struct Decorated {
    form: vec3<f32>,
    pale: f32,
    tint: vec3<f32>,
}

fn hue(proximal: f32) -> vec3<f32> {
    let trachea = vec3<f32>(HUE[0].x, HUE[1].x, HUE[2].x);
    let beyond = vec3<f32>(HUE[0].y, HUE[1].y, HUE[2].y);
    let region = fma(vec3<f32>(proximal), trachea - beyond, beyond);
    return fma(vec3<f32>(light.hue), region, vec3<f32>(1.0));
}

fn decorated(lps: vec3<f32>, normal: vec3<f32>, cosine: f32, footprint_mm: f32, skin: Skin) -> Decorated {
    var out = Decorated(vec3<f32>(0.0), 0.0, vec3<f32>(1.0));
    let found = anatomy_at(lps);
    if !found.inside {
        out.tint = hue(0.0);
        return out;
    }
    let left = found.across.x;
    let back = found.across.y;
    let off = sqrt(fma(left, left, back * back));
    let beyond = ramp(off, NEAR_AXIS);
    out.tint = hue(found.proximal * beyond);
    let ridge = found.spur * light.spurs * beyond;
    if max(found.rings * light.rings, found.membrane * light.membrane) <= 0.0 {
        out.pale = min(ridge * PALE_RIDGE, 1.0);
        return out;
    }
    let on_tube = ramp(off, ON_TUBE) * beyond;
    let on_back = ramp(off, ON_BACK) * beyond;
    let between_forks = 1.0 - smoothed(found.spur * AT_FORK);
    let cos_back = fma(skin.mottle, RAGGED, back / max(off, LEAST_OFF));
    let at_back = smoothed((cos_back - BACK.x) * (1.0 / (BACK.y - BACK.x)));

    let per_mm = sqrt(dot_of(found.growth, found.growth));
    let axis = unit(found.growth);
    let width = footprint_mm * per_mm / max(cosine, LEAST_FACING);
    let seen = ramp(width, RINGS_SEEN);
    let stray = lerp(found.regular, STRAY.y, STRAY.x);
    let phase = fma(skin.mottle, stray, found.phase);
    let t = (phase - floor(phase)) - 0.5;
    let edge = max(EDGE, width);
    let per_edge = 1.0 / edge;
    let inwards = clamp((fma(edge, 0.5, HALF_WIDTH) - abs(t)) * per_edge, 0.0, 1.0);
    let own_ring = smoothed(inwards);
    let side = inwards * (1.0 - inwards) * (6.0 * per_edge);
    let steep = select(-side, side, t < 0.0);
    let plates = lerp(found.regular, ramp(skin.mottle, PLATES), 1.0);
    let no_back = fma(at_back * found.membrane, -1.0, 1.0);
    let strength = found.rings * light.rings * (plates * no_back) * (on_tube * between_forks);
    out.form = along(out.form, strength * seen * (steep * HEIGHT), axis);
    let ring = lerp(seen, 2.0 * HALF_WIDTH, own_ring);
    out.pale = strength * ring * PALE_RING;
    let interval = strength * fma(skin.mottle, RED.x, RED.y) * (1.0 - ring);

    let membrane = found.membrane * light.membrane * (at_back * (on_back * between_forks));
    var fold = 0.0;
    if membrane > 0.0 {
        let across = unit(vec3<f32>(-axis.z, 0.0, axis.x));
        let q = vec3<f32>(
            fma(left, FOLDS.x, skin.mottle * WINDING),
            found.phase * FOLDS.y,
            back * FOLDS_BACK,
        );
        let folds = noise(q, FOLD_SEED);
        let near = sharpness(footprint_mm, FOLDS_PER_MM);
        fold = folds.x * near * membrane;
        let sideways = dot_of(normal, across);
        let flattened = sideways * FLAT * membrane;
        let lean = folds.y * near * membrane * fma(-sideways, sideways, 1.0);
        out.form = along(out.form, fma(lean, FOLD, flattened), across);
    }
    out.pale = min(fma(ridge * (1.0 - out.pale), PALE_RIDGE, out.pale), 1.0);
    let of_interval = vec3<f32>(BLOOD[0].x, BLOOD[1].x, BLOOD[2].x);
    let of_membrane = vec3<f32>(BLOOD[0].y, BLOOD[1].y, BLOOD[2].y);
    let of_fold = vec3<f32>(BLOOD[0].z, BLOOD[1].z, BLOOD[2].z);
    let of_walls = fma(vec3<f32>(membrane), of_membrane, fold * of_fold);
    let blood = fma(vec3<f32>(interval), of_interval, of_walls);
    out.tint = fma(out.tint, blood, out.tint);
    return out;
}

// --- Wet surface ------------------------------------------------------------------------------------------------------

struct Film {
    glint: f32,
    drop: vec3<f32>,
    pool: f32,
}

// Return the normal of the sides of a bump of a noise, and the height of the bump above `from`.
fn bump(height: vec4<f32>, from_height: f32, n: vec3<f32>) -> vec4<f32> {
    let tilted = along(n, -DROP_SLOPE, from_lattice(height.yzw));
    return vec4<f32>(unit(tilted), smoothed((height.x - from_height) * DROP_EDGE));
}

fn film_at(lps: vec3<f32>, n: vec3<f32>, footprint_mm: f32, thick: f32, bumps: vec4<f32>) -> Film {
    var film = Film(0.0, n, 0.0);
    let near = ramp(footprint_mm * WRINKLES_PER_MM, FADES);
    if light.specks > 0.0 && near > 0.0 {
        let drop = bump(bumps, fma(thick, -GATHER, DROP_FROM), n);
        film.drop = drop.xyz;
        film.glint = drop.w * near * (DROP_GLINT * light.specks);
    }
    if light.secretions > 0.0 {
        let q = to_lattice(lps);
        let bottom = ramp(n.y, FLOOR);
        let level = noise(q * POOLS_PER_MM, WET_SEEDS.x).x + fma(light.secretions, POOL_LEVEL.x, POOL_LEVEL.y);
        film.pool = bottom * smoothed(level * POOL_EDGE);
        let bubble = bump(noise(q * BUBBLES_PER_MM, WET_SEEDS.y), BUBBLE_FROM, n);
        let here = bubble.w * ramp(footprint_mm * BUBBLES_PER_MM, FADES) * film.pool;
        if here > 0.0 {
            film.glint = here * BUBBLE_GLINT;
            film.drop = bubble.xyz;
        }
    }
    return film;
}

// --- Light ------------------------------------------------------------------------------------------------------------

fn wall_of(gathered: Gathered, delta: vec3<f32>) -> Wall {
    let opacity = max(1.0 - gathered.transparency, 1e-6);
    return Wall(delta, max(gathered.hit, 0.0), gathered.transparency, gathered.rgb / opacity);
}

// Light of the guides at a wall.
struct Received {
    direct: f32,
    round: f32,
    gloss: f32,
    glints: f32,
}

fn add_guide(
    received: ptr<function, Received>,
    guide: vec3<f32>,
    offset: vec3<f32>,
    back: vec3<f32>,
    n_matt: vec3<f32>,
    n_film: vec3<f32>,
    film: Film,
    wrap: f32,
    exposure: f32,
) {
    let to_guide = guide - offset;
    let dir = unit(to_guide);
    let strength = 0.5 * exposure / (dot_of(to_guide, to_guide) + GUIDE_MM2);
    let cosine = (dot_of(n_matt, dir) + wrap) * (1.0 / (1.0 + wrap));
    (*received).direct = fma(strength, max(cosine, 0.0), (*received).direct);
    (*received).round += strength;
    let half = unit(along(back, 1.0, dir));
    var highlight = max(dot_of(n_film, half), 0.0);
    for (var n = 0u; n < light.shininess_log2; n++) {
        highlight *= highlight;
    }
    (*received).gloss = fma(strength, highlight, (*received).gloss);
    if film.glint > 0.0 {
        var towards = max(dot_of(film.drop, half), 0.0);
        for (var n = 0u; n < DROP_LOG2; n++) {
            towards *= towards;
        }
        (*received).glints = fma(strength, towards * film.glint, (*received).glints);
    }
}

// Return the linear colour of a shaded wall, before the tone curve; `plain` leaves out gloss and decoration.
fn lit(wall: Wall, plain: bool, wrap: f32, exposure: f32) -> vec3<f32> {
    let p = along(frame.origin.xyz, wall.hit, wall.delta);
    let step = turned(light.lps_from_ijk, wall.delta);
    let offset = step * wall.hit;
    let back = step * (-1.0 / frame.step_mm);
    let depth = wall.hit * frame.step_mm;

    let gradient = turned(light.inward, rise(p));
    let steep = sqrt(dot_of(gradient, gradient));
    var n = unit(gradient);
    n *= select(-1.0, 1.0, dot_of(n, back) > 0.0);
    if steep < FLAT_SLOPE {
        n = back;
    }

    let dense = value_in(cell_of(along(p, -BENEATH_MM, turned(light.ijk_from_lps, n))));
    var pale = smoothed((dense - light.held.z) * (1.0 / (light.held.w - light.held.z))) * light.paleness;

    var n_film = n;
    var thick = MEAN_FILM;
    var tint = vec3<f32>(1.0);
    var bumps = vec4<f32>(0.0);
    let lps = along(light.camera_lps.xyz, 1.0, offset);
    let footprint = depth * light.pixel_mm;
    let textured = light.texture > 0.0 || light.vessels > 0.0 || light.specks > 0.0;
    if !plain && (textured || light.has_decoration == 1u) {
        let skin = skin_at(lps, footprint);
        thick = skin.film;
        tint = skin.tint;
        bumps = skin.bumps;
        if light.has_decoration == 1u {
            let laid = decorated(lps, n, abs(dot_of(n, back)), footprint, skin);
            n = unit(along(n, -1.0, laid.form));
            pale = fma(1.0 - pale, laid.pale, pale);
            tint *= laid.tint;
        }
        n_film = unit(along(n, -1.0, skin.relief));
    }
    let shown = fma(vec3<f32>(pale), PALE_RGB - wall.albedo, wall.albedo);
    var colour = shown * shown * tint;
    // Half of the relief also affects the diffuse light.
    let n_matt = unit(along(n, 1.0, n_film));
    var film = Film(0.0, n, 0.0);
    if !plain && (light.specks > 0.0 || light.secretions > 0.0) {
        film = film_at(lps, n, footprint, thick, bumps);
        if light.secretions > 0.0 {
            let secretions = SECRETIONS_RGB * SECRETIONS_RGB;
            colour = fma(vec3<f32>(film.pool * COVER), secretions - colour, colour);
            let level = vec3<f32>(0.0, -1.0, 0.0);
            n_film = unit(fma(vec3<f32>(film.pool * POOL_FLAT), level - n_film, n_film));
        }
    }

    var received = Received(0.0, 0.0, 0.0, 0.0);
    add_guide(&received, light.guide_a.xyz, offset, back, n_matt, n_film, film, wrap, exposure);
    add_guide(&received, light.guide_b.xyz, offset, back, n_matt, n_film, film, wrap, exposure);
    let gloss = fma(received.gloss * thick, select(light.gloss, 0.0, plain), received.glints);
    let round = received.round * light.ambient;
    let all_light = fma(vec3<f32>(round), TINT_RGB, vec3<f32>(received.direct));
    return fma(colour, all_light, vec3<f32>(gloss));
}

// Return the levels of a pixel with the results of its ray.
fn shown_levels(gathered: Gathered, delta: vec3<f32>, wrap: f32) -> vec3<u32> {
    let wall = wall_of(gathered, delta);
    let behind = frame.background.rgb;
    var v = vec3<f32>(0.0);
    if gathered.hit >= 0.0 {
        let x = lit(wall, false, wrap, state.exposure);
        let tone = x * fma(x, vec3<f32>(1.0 / (WHITE * WHITE)), vec3<f32>(1.0)) / (x + 1.0);
        let curve = sqrt(max(tone, vec3<f32>(0.0)));
        let toed = curve * fma(curve, vec3<f32>(TOE), vec3<f32>(1.0 - TOE));
        v = fma(vec3<f32>(wall.transparency), behind - toed, toed);
    } else {
        v = wall.transparency * behind;
    }
    if light.fog > 0.0 {
        let dir = turned(light.camera_from_lps, turned(light.lps_from_ijk, delta));
        let patches = noise(dir * (PATCHES / frame.step_mm), MIST_SEED).x;
        let veil = fma(patches, MIST_COVER.x, MIST_COVER.y) * light.fog;
        v = fma(vec3<f32>(veil), MIST_RGB - v, v);
    }
    return levels(v);
}

// --- Stages of a picture ----------------------------------------------------------------------------------------------

fn gathered_at(pixel: u32) -> Gathered {
    let rgb = vec3<f32>(
        bitcast<f32>(walls[5u * pixel]),
        bitcast<f32>(walls[5u * pixel + 1u]),
        bitcast<f32>(walls[5u * pixel + 2u]),
    );
    return Gathered(rgb, bitcast<f32>(walls[5u * pixel + 3u]), bitcast<f32>(walls[5u * pixel + 4u]));
}

// Cast the rays from which the exposure is computed, and store the light that their walls reflect.
@compute @workgroup_size(8)
fn meter(@builtin(global_invocation_id) at: vec3<u32>) {
    let n = at.x;
    if n >= METERED * METERED {
        return;
    }
    let column = (2u * (n % METERED) + 1u) * frame.width / (2u * METERED);
    let row = (2u * (n / METERED) + 1u) * frame.height / (2u * METERED);
    let ray = ray_along(direction_of(column, row).xyz);
    var work = Work();
    let gathered = gather(ray, &work);
    var reflected = 0.0;
    if gathered.hit >= 0.0 {
        reflected = dot_of(lit(wall_of(gathered, ray.delta), true, light.wrap, 1.0), LUMINANCE);
    }
    state.metered[n] = reflected;
}

// Compute the exposure of the picture from the metered light.
@compute @workgroup_size(1)
fn expose() {
    if light.exposure >= 0.0 {
        state.exposure = light.exposure;
        return;
    }
    var brightest = 1e-20;
    for (var n = 0u; n < METERED * METERED; n++) {
        brightest = max(brightest, state.metered[n]);
    }
    // Fourth powers of parts of the brightest light neither overflow nor vanish in f32.
    var sum = 0.0;
    for (var n = 0u; n < METERED * METERED; n++) {
        let part = state.metered[n] / brightest;
        sum += part * part * part * part;
    }
    let mean = brightest * sqrt(sqrt(sum / f32(METERED * METERED)));
    state.exposure = min(EXPOSED_TO / max(mean, 1e-9), 1e6);
}

// Assign a place in the store to each brick that the walls of a band need.
@compute @workgroup_size(8, 8)
fn request_bricks(@builtin(global_invocation_id) at: vec3<u32>) {
    if at.x >= frame.width || at.y >= frame.num_rows {
        return;
    }
    let hit = bitcast<f32>(walls[5u * (at.y * frame.width + at.x) + 4u]);
    if hit <= 0.0 {
        return;
    }
    let delta = ray_along(direction_of(at.x, frame.first_row + at.y).xyz).delta;
    let number = brick_number(cell_of(along(frame.origin.xyz, hit, delta)).ijk);
    if atomicLoad(&bricks.entries[number]) != 0u || atomicLoad(&bricks.requested) >= light.num_bricks.w {
        return;
    }
    if atomicCompareExchangeWeak(&bricks.entries[number], 0u, BUSY).exchanged {
        let index = atomicAdd(&bricks.requested, 1u);
        if index < light.num_bricks.w {
            slopes[index * BRICK_WORDS + BRICK_WORDS - 1u] = number;
            atomicStore(&bricks.entries[number], index + 1u);
        } else {
            atomicStore(&bricks.entries[number], 0u);
        }
    }
}

// Compute the slopes of the bricks that were requested and not yet filled.
@compute @workgroup_size(128)
fn fill_bricks(
    @builtin(local_invocation_index) voxel_index: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) num_groups: vec3<u32>,
) {
    let end = min(atomicLoad(&bricks.requested), light.num_bricks.w);
    for (var index = atomicLoad(&bricks.filled) + group.x; index < end; index += num_groups.x) {
        let number = slopes[index * BRICK_WORDS + BRICK_WORDS - 1u];
        let n = light.num_bricks.xyz;
        let brick = vec3<u32>(number % n.x, number / n.x % n.y, number / (n.x * n.y));
        for (var at = voxel_index; at < BRICK_VOXELS * BRICK_VOXELS * BRICK_VOXELS; at += 128u) {
            let local = vec3<u32>(
                at % BRICK_VOXELS,
                at / BRICK_VOXELS % BRICK_VOXELS,
                at / (BRICK_VOXELS * BRICK_VOXELS),
            );
            let slope = vec3<u32>(slope_of(vec3<i32>(brick * CELLS + local)));
            let word = index * BRICK_WORDS + VOXEL_WORDS * at;
            slopes[word] = slope.x & 0xffffu | slope.y << 16u;
            slopes[word + 1u] = slope.z & 0xffffu | 1u << 16u;
        }
    }
}

var<workgroup> num_shaded: atomic<u32>;

// Shade the walls of a band.
@compute @workgroup_size(8, 8)
fn light_walls(@builtin(global_invocation_id) at: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    if all(at.xy == vec2<u32>(0u)) {
        let stored = min(atomicLoad(&bricks.requested), light.num_bricks.w);
        atomicStore(&bricks.filled, stored);
    }
    if at.x < frame.width && at.y < frame.num_rows {
        let pixel = at.y * frame.width + at.x;
        let gathered = gathered_at(pixel);
        // A ray that was not cast has the depth 0 of the cleared buffer; its pixel stays unmarked.
        if gathered.hit != 0.0 {
            let direction = direction_of(at.x, frame.first_row + at.y);
            let delta = ray_along(direction.xyz).delta;
            let index = frame.out_row * frame.width + pixel;
            depths[index] = gathered.hit;
            store_pixel(index, darkened(shown_levels(gathered, delta, light.wrap), direction.w));
            if gathered.hit > 0.0 {
                atomicAdd(&num_shaded, 1u);
            }
        }
    }
    workgroupBarrier();
    if lane == 0u && frame.counts_work == 1u {
        atomicAdd(&state.num_lit, atomicLoad(&num_shaded));
    }
}

// Return the inverse depth of a pixel in steps; 0 for a ray without a wall.
fn inverse_depth(column: u32, row: u32) -> f32 {
    let direction = direction_of(column, frame.first_of_all + row).xyz;
    if dot(direction, direction) <= 0.5 {
        return NO_RAY;
    }
    let depth = depths[row * frame.width + column];
    return select(1.0 / max(depth, 1.0), 0.0, depth < 0.0);
}

fn bends(before: f32, middle: f32, after: f32, least: f32) -> bool {
    let nearest = max(max(before, middle), after);
    let has_rays = min(min(before, middle), after) >= 0.0;
    return has_rays && nearest > least && abs(before - 2.0 * middle + after) > BEND * nearest;
}

// List the pixels of a band at the edge of a near wall in front of a far wall.
@compute @workgroup_size(8, 8)
fn mark_silhouettes(@builtin(global_invocation_id) at: vec3<u32>) {
    if at.x >= frame.width || at.y >= frame.num_rows {
        return;
    }
    let row = frame.out_row + at.y;
    // Inverse depth below which the reflected light is too faint for a visible staircase.
    let least = sqrt(FAINT / max(state.exposure, 1e-9)) * frame.step_mm;
    let middle = inverse_depth(at.x, row);
    var marked = false;
    if at.x > 0u && at.x + 1u < frame.width {
        marked = bends(inverse_depth(at.x - 1u, row), middle, inverse_depth(at.x + 1u, row), least);
    }
    if row > 0u && row + 1u < frame.num_all_rows {
        marked = marked || bends(inverse_depth(at.x, row - 1u), middle, inverse_depth(at.x, row + 1u), least);
    }
    if marked {
        state.marked[atomicAdd(&state.num_marked, 1u)] = row * frame.width + at.x;
    }
}

// Return a neighbour's direction, or 0 0 0 if the neighbour is outside the picture.
fn neighbour(column: i32, row: i32) -> vec3<f32> {
    if column < 0 || row < 0 || column >= i32(frame.width) || row >= i32(frame.height) {
        return vec3<f32>(0.0);
    }
    return direction_of(u32(column), u32(row)).xyz;
}

// Return the change of direction from pixel to pixel; a missing neighbour is replaced by the mirror image of the other.
fn change(before: vec3<f32>, here: vec3<f32>, after: vec3<f32>) -> vec3<f32> {
    let has_before = any(before != vec3<f32>(0.0));
    let has_after = any(after != vec3<f32>(0.0));
    if has_before && has_after {
        return (after - before) / 2.0;
    }
    if has_before {
        return here - before;
    }
    return select(vec3<f32>(0.0), after - here, has_after);
}

// Return the direction of a ray that is displaced from a pixel's centre by fractions of a pixel.
fn direction_beside(column: u32, row: u32, beside: vec2<f32>) -> vec3<f32> {
    if frame.has_lens == 0u {
        return pinhole(f32(column) + 0.5 + beside.x, f32(row) + 0.5 + beside.y).xyz;
    }
    let x = i32(column);
    let y = i32(row);
    let here = direction_of(column, row).xyz;
    let dir = here
        + beside.x * change(neighbour(x - 1, y), here, neighbour(x + 1, y))
        + beside.y * change(neighbour(x, y - 1), here, neighbour(x, y + 1));
    return dir / sqrt(dot(dir, dir));
}

// Cast and shade two rays for each listed pixel, and store their mean.
@compute @workgroup_size(64)
fn smooth_silhouettes(
    @builtin(global_invocation_id) at: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(num_workgroups) num_groups: vec3<u32>,
) {
    let end = min(atomicLoad(&state.num_marked), light.first_marked + light.most_marked);
    let wrap = max(light.wrap, EDGE_WRAP);
    var work = Work();
    for (var n = light.first_marked + at.x; n < end; n += 64u * num_groups.x) {
        let index = state.marked[n];
        let column = index % frame.width;
        let row = frame.first_of_all + index / frame.width;
        var sum = vec3<u32>(1u);
        for (var side = 0; side < 2; side++) {
            let beside = select(BESIDE[0], BESIDE[1], side == 1);
            let ray = ray_along(direction_beside(column, row, beside));
            let gathered = gather(ray, &work);
            sum += shown_levels(gathered, ray.delta, wrap);
            if gathered.hit >= 0.0 {
                atomicAdd(&num_shaded, 1u);
            }
        }
        store_pixel(index, darkened(sum / 2u, direction_of(column, row).w));
    }
    add_work(work);
    workgroupBarrier();
    if lane == 0u {
        count_work();
        atomicAdd(&state.num_lit, atomicLoad(&num_shaded));
    }
}
