// Slopes of the volume at walls: the operations of crates/raycast (bricks/slopes.rs, packet/slopes.rs).

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
