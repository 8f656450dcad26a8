// Shading of first walls on a GPU: the operations of `lit` and `light_row` in crates/raycast/src/packet/lighting.rs.
//
// The constants in capitals come from that crate (shader.rs). The other files of the shading are slopes.wgsl,
// texture.wgsl, decoration.wgsl, film.wgsl and stages.wgsl.

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
