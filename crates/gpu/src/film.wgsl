// Wet surface of the wall: the operations of crates/raycast/src/packet/film.rs.

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
