use carina_grid::{Affine, cross, dot, unit};

/// Return the vector `a` mirrored in the plane with normal `v`.
fn mirrored(a: [f64; 3], v: [f64; 3]) -> [f64; 3] {
    let vv = dot(v, v);
    if vv < 1e-30 {
        return a;
    }
    let f = 2.0 * dot(v, a) / vv;
    std::array::from_fn(|i| a[i] - f * v[i])
}

/// Return camera frames along a curve that rotate about the tangent as little as possible.
///
/// The method is double reflection (Wang, Juettler, Zheng and Liu, "Computation of rotation minimizing frames", ACM TOG
/// 27(1), 2008, table I). `tangents` are unit vectors, one per point. `up` defines the first frame; it need not be
/// perpendicular to the first tangent, but must not be along it (then the result is `None`). Each frame has +x right,
/// +y down, +z along the tangent, and the point as origin.
#[must_use]
pub fn rotation_minimising_frames(
    points: &[[f64; 3]],
    tangents: &[[f64; 3]],
    up: [f64; 3],
) -> Option<Vec<Affine>> {
    let first = *tangents.first()?;
    let along = dot(up, first);
    let mut down = unit(std::array::from_fn(|i| along * first[i] - up[i]))?;
    let mut frames = Vec::with_capacity(points.len());
    for (i, (&point, &tangent)) in points.iter().zip(tangents).enumerate() {
        if i > 0 {
            let before = points[i - 1];
            let step: [f64; 3] = std::array::from_fn(|a| point[a] - before[a]);
            let tangent_left = mirrored(tangents[i - 1], step);
            let down_left = mirrored(down, step);
            let rest: [f64; 3] = std::array::from_fn(|a| tangent[a] - tangent_left[a]);
            down = mirrored(down_left, rest);
            // Two reflections preserve right angles except for rounding errors, which would accumulate over thousands
            // of points.
            let along = dot(down, tangent);
            down = unit(std::array::from_fn(|a| down[a] - along * tangent[a]))?;
        }
        frames.push(Affine::from_columns(
            cross(down, tangent),
            down,
            tangent,
            point,
        ));
    }
    Some(frames)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Return points and tangents of a helix of radius `a` and slope `b`, by arc length.
    fn helix(a: f64, b: f64, length: f64, num: usize) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
        let c = (a * a + b * b).sqrt();
        (0..num)
            .map(|i| {
                let t = length * i as f64 / (num - 1) as f64 / c;
                let (s, co) = (libm::sin(t), libm::cos(t));
                ([a * co, a * s, b * t], [-a * s / c, a * co / c, b / c])
            })
            .unzip()
    }

    #[test]
    fn frames_on_a_helix_rotate_against_the_normal_by_the_torsion() {
        // The frame turns by -torsion * length relative to the Frenet frame; torsion = b / (a^2 + b^2).
        let (a, b, length) = (10.0, 4.0, 60.0);
        let torsion = b / (a * a + b * b);
        let mut errors = Vec::new();
        for num in [31usize, 61] {
            let (points, tangents) = helix(a, b, length, num);
            // The Frenet normal at the start points to the axis, -x; it is used as "up", so down is +x.
            let frames = rotation_minimising_frames(&points, &tangents, [-1.0, 0.0, 0.0]).unwrap();
            let last = frames.last().unwrap();
            let p = points[num - 1];
            let outwards = unit([p[0], p[1], 0.0]).unwrap();
            let binormal = cross(tangents[num - 1], outwards.map(|v| -v));
            let down = last.column(1);
            let angle = libm::atan2(dot(down, binormal), dot(down, outwards));
            // The Frenet normal (inwards) turns by the torsion about the tangent, so the frame lags behind it by this
            // angle.
            errors.push((angle - torsion * length).abs());
        }
        assert!(errors[1] < 1e-5, "{errors:?}");
        // The method has fourth order (Wang 2008, 4.2): with half the step the error is a sixteenth; 12 allows for the
        // next order.
        assert!(errors[0] / errors[1] > 12.0, "{errors:?}");
    }

    #[test]
    fn frames_of_a_plane_curve_contain_the_normal_of_the_plane() {
        let (points, tangents) = helix(20.0, 0.0, 90.0, 50);
        let frames = rotation_minimising_frames(&points, &tangents, [0.0, 0.0, 1.0]).unwrap();
        for frame in frames {
            assert!(frame.is_rigid(1e-12));
            assert!((frame.column(1)[2] + 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn an_up_direction_along_the_tangent_gives_none() {
        let (points, tangents) = helix(20.0, 0.0, 90.0, 5);
        assert!(rotation_minimising_frames(&points, &tangents, tangents[0]).is_none());
    }
}
