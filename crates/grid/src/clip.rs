/// Return the part of the line `origin + t * direction` inside the box `lo..=hi`, as `(t_in, t_out)`.
///
/// The result is `None` if the line misses the box. The origin may be inside or outside; `t` may be negative. On an
/// axis along which the direction is 0, only the origin decides, so no 0/0 occurs on a face.
#[must_use]
pub fn clip_line_to_box(
    origin: [f64; 3],
    direction: [f64; 3],
    lo: [f64; 3],
    hi: [f64; 3],
) -> Option<(f64, f64)> {
    let (mut t_in, mut t_out) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        if direction[axis] == 0.0 {
            if origin[axis] < lo[axis] || origin[axis] > hi[axis] {
                return None;
            }
        } else {
            let a = (lo[axis] - origin[axis]) / direction[axis];
            let b = (hi[axis] - origin[axis]) / direction[axis];
            t_in = t_in.max(a.min(b));
            t_out = t_out.min(a.max(b));
        }
    }
    (t_in <= t_out).then_some((t_in, t_out))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_line_along_a_face_is_inside() {
        let hit = clip_line_to_box([0.0, 0.0, -5.0], [0.0, 0.0, 1.0], [0.0; 3], [1.0, 2.0, 3.0]);
        assert_eq!(hit, Some((5.0, 8.0)));
        assert_eq!(
            clip_line_to_box(
                [-0.1, 0.0, -5.0],
                [0.0, 0.0, 1.0],
                [0.0; 3],
                [1.0, 2.0, 3.0]
            ),
            None
        );
    }

    proptest! {
        #[test]
        fn points_between_the_ends_are_inside_and_points_beyond_are_not(
            origin in prop::array::uniform3(-20.0f64..20.0),
            direction in prop::array::uniform3(-1.0f64..1.0),
            f in 0.001f64..0.999,
        ) {
            prop_assume!(crate::length(direction) > 0.1);
            let (lo, hi) = ([-0.5, -0.5, -0.5], [7.5, 4.5, 9.5]);
            let inside = |t: f64| (0..3).all(|a| {
                let p = origin[a] + t * direction[a];
                // The tolerance of 1e-9 allows for the rounding of coordinates below 100.
                p >= lo[a] - 1e-9 && p <= hi[a] + 1e-9
            });
            match clip_line_to_box(origin, direction, lo, hi) {
                Some((t0, t1)) => {
                    prop_assert!(inside(t0 + f * (t1 - t0)));
                    prop_assert!(!inside(t0 - 1e-3) && !inside(t1 + 1e-3));
                }
                None => for n in -400..400 {
                    prop_assert!(!inside(f64::from(n) * 0.1));
                },
            }
        }
    }
}
