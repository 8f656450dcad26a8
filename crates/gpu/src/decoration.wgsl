// Decoration from the airway tree: the operations of crates/raycast/src/packet/rings.rs.

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
