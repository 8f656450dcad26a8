//! Tests that invalid input is rejected with a message that gives the value found and the allowed values.

use carina_grid::{Affine, Camera, Grid, VolumeView};
use carina_raycast::{
    Frame, FrameOptions, Interpolation, Light, RaycastError, Transfer, TransferTable,
};

fn camera_refusal(pose: Affine, fov_deg: f64, width: usize, height: usize) -> String {
    Camera::new(pose, fov_deg.to_radians(), width, height)
        .unwrap_err()
        .to_string()
}

fn pose(change: impl Fn(&mut [[f64; 4]; 3])) -> Affine {
    let mut rows = *Affine::IDENTITY.rows();
    change(&mut rows);
    Affine::from_rows(rows)
}

#[test]
fn invalid_poses_are_rejected() {
    for bad in [
        pose(|m| m[0][0] = f64::NAN),
        pose(|m| m[2][3] = f64::NAN),
        pose(|m| m[1][3] = f64::INFINITY),
        pose(|m| m[2][2] = 0.0),
        pose(|m| m[2][2] = -1.0),
        pose(|m| m[0][1] = 0.01),
    ] {
        let words = camera_refusal(bad, 90.0, 64, 64);
        assert!(
            words.contains("right-handed") || words.contains("finite"),
            "{words}"
        );
    }
}

#[test]
fn fields_of_view_and_sizes_out_of_range_are_rejected_with_value_and_range() {
    for deg in [-1.0, 0.0, 0.99, 170.01, 180.0, 360.0] {
        let words = camera_refusal(Affine::IDENTITY, deg, 64, 64);
        assert!(
            words.contains("1 to 170") && words.contains(&format!("{deg:.2}")),
            "{words}"
        );
    }
    assert!(camera_refusal(Affine::IDENTITY, f64::NAN, 64, 64).contains("NaN"));
    for (width, height) in [(0, 64), (64, 0), (8193, 64), (64, 8193), (usize::MAX, 1)] {
        let words = camera_refusal(Affine::IDENTITY, 90.0, width, height);
        assert!(
            words.contains("1 to 8192") && words.contains(&format!("{width} x {height}")),
            "{words}"
        );
    }
    assert!(Camera::new(Affine::IDENTITY, 1.0, 8192, 1).is_ok());
}

#[test]
fn invalid_transfer_functions_are_rejected_with_the_value_found() {
    let flat = |hu: f64, alpha: f64| [hu, 0.5, 0.5, 0.5, alpha];
    for (points, found) in [
        (vec![], "no points"),
        (vec![flat(0.0, 0.5), flat(f64::NAN, 0.5)], "NaN"),
        (vec![flat(0.0, f64::INFINITY)], "inf"),
        (vec![flat(0.0, 1.0 + 1e-9)], "1.000000001"),
        (vec![flat(0.0, -0.25)], "-0.25"),
        (vec![[0.0, 0.5, 7.5, 0.5, 0.5]], "7.5"),
        (vec![flat(5.0, 0.1), flat(4.0, 0.1)], "4 follows 5"),
    ] {
        let words = Transfer::new(points, 1.0, 1).unwrap_err().to_string();
        assert!(words.contains(found), "{words}");
    }
    for reference_mm in [0.0, -1.0, f64::NAN] {
        let words = Transfer::new(vec![flat(0.0, 0.5)], reference_mm, 1)
            .unwrap_err()
            .to_string();
        assert!(words.contains(&reference_mm.to_string()), "{words}");
    }
    let transfer = Transfer::new(vec![flat(0.0, 0.5)], 1.0, 1).unwrap();
    for step_mm in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let words = TransferTable::new(&transfer, step_mm, 0, 1)
            .unwrap_err()
            .to_string();
        assert!(
            words.contains("above 0 mm") && words.contains(&step_mm.to_string()),
            "{words}"
        );
    }
}

#[test]
fn lights_out_of_range_are_rejected_with_value_and_range() {
    let grid = Grid::new([3, 4, 5], Affine::IDENTITY).unwrap();
    let hu = vec![0i16; 60];
    let volume = VolumeView::new(&hu, &grid).unwrap();
    let transfer = Transfer::new(vec![[0.0, 0.5, 0.5, 0.5, 0.5]], 1.0, 1).unwrap();
    let table = TransferTable::new(&transfer, 0.5, 0, 1).unwrap();
    let good = Light {
        ambient: 0.1,
        diffuse: 0.9,
        specular: 0.0,
        shininess_log2: 3,
        reach_mm: 20.0,
    };
    let refused = |light: Light, interpolation| -> RaycastError {
        let options = FrameOptions {
            interpolation,
            light: Some(light),
            appearance: None,
            background: [0.0; 3],
        };
        let camera = Camera::new(Affine::IDENTITY, 1.0, 8, 8).unwrap();
        Frame::new(volume, &table, camera, options).unwrap_err()
    };
    for (light, found) in [
        (
            Light {
                ambient: f32::NAN,
                ..good
            },
            "NaN",
        ),
        (
            Light {
                diffuse: -0.5,
                ..good
            },
            "-0.5",
        ),
        (
            Light {
                specular: 10.5,
                ..good
            },
            "10.5",
        ),
        (
            Light {
                shininess_log2: 11,
                ..good
            },
            "11",
        ),
        (
            Light {
                reach_mm: 0.0,
                ..good
            },
            "0",
        ),
    ] {
        let words = refused(light, Interpolation::Trilinear).to_string();
        assert!(
            words.contains(found) && words.contains("expected"),
            "{words}"
        );
    }
    let camera = Camera::new(Affine::IDENTITY, 1.0, 8, 8).unwrap();
    let options = FrameOptions {
        appearance: None,
        interpolation: Interpolation::Trilinear,
        light: None,
        background: [0.0; 3],
    };
    for transparency in [0.0, -1.0, 0.5, f32::NAN] {
        let frame = Frame::new(volume, &table, camera.clone(), options).unwrap();
        let words = frame.stopping_at(transparency).unwrap_err().to_string();
        assert!(
            words.contains("1/4") && words.contains(&transparency.to_string()),
            "{words}"
        );
    }
    assert_eq!(
        refused(good, Interpolation::Nearest).code(),
        "render.setting"
    );
}
