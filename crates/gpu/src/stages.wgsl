// Stages of a picture after the cast: exposure, slopes, light, silhouettes (crates/raycast: exposure.rs, silhouette.rs).

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
