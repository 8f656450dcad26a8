//! Tests of lenses: conversions in both directions, known values, and rejected values.

use proptest::prelude::*;

use crate::Distortion;
use crate::lens::{Calibration, Lens, Optics};

fn brown(k1: f64, k2: f64, p1: f64, p2: f64) -> Lens {
    Lens::Distorted(Distortion::Brown {
        k: [k1, k2, 0.0, 0.0, 0.0, 0.0],
        p: [p1, p2],
    })
}

fn fisheye(k1: f64) -> Lens {
    Lens::Distorted(Distortion::Fisheye {
        k: [k1, 0.0, 0.0, 0.0],
    })
}

#[test]
fn an_equidistant_lens_puts_equal_angles_at_equal_distances() {
    let optics = Optics::new(&Lens::Equidistant, Some(170f64.to_radians()), 340, 340).unwrap();
    for degrees in [0.0, 10.0, 45.0, 85.0, 100.0f64] {
        let a = degrees.to_radians();
        let [x, y] = optics.pixel([a.sin(), 0.0, a.cos()]).unwrap();
        // 340 pixels over 170 degrees are 2 pixels per degree.
        assert!((x - 170.0 - 2.0 * degrees).abs() < 1e-9 && (y - 170.0).abs() < 1e-12);
    }
    // In a picture that is large enough, directions behind the camera have points too.
    assert!(optics.pixel([0.1, 0.0, -1.0]).is_some());
    assert!(optics.pixel([0.0, 0.0, -1.0]).is_none());
}

#[test]
fn the_field_of_view_spans_the_shorter_side_with_every_lens() {
    for lens in [
        Lens::Pinhole,
        Lens::Equidistant,
        brown(-0.1, 0.02, 0.0, 0.0),
        fisheye(0.16),
    ] {
        let optics = Optics::new(&lens, Some(2.0), 300, 200).unwrap();
        let d = optics.direction([150.0, 0.0]).unwrap();
        assert!((libm::atan2(-d[1], d[2]) - 1.0).abs() < 1e-12, "{lens:?}");
        assert!((optics.fov_rad() - 2.0).abs() < 1e-15);
    }
}

#[test]
fn a_lens_that_folds_back_inside_the_picture_is_rejected_and_outside_is_limited() {
    // r (1 - 0.3 r^2) folds back at r^2 = 1 / 0.9, which is 46.51 degrees.
    let lens = brown(-0.3, 0.0, 0.0, 0.0);
    let words = Optics::new(&lens, Some(120f64.to_radians()), 64, 64)
        .unwrap_err()
        .to_string();
    assert!(
        words.contains("less than 93.0 degrees") && words.contains("120.00"),
        "{words}"
    );
    let optics = Optics::new(&lens, Some(92f64.to_radians()), 64, 64).unwrap();
    assert!(optics.direction([0.5, 32.0]).is_some());
    assert!(
        optics.direction([0.5, 0.5]).is_none(),
        "the corner lies beyond the fold"
    );
    assert!((optics.limit_rad().to_degrees() - 46.51).abs() < 0.01);
    // The same model comes from a calibration, which needs no field of view.
    let folded = Lens::Calibrated(Calibration {
        distortion: Distortion::Brown {
            k: [-0.3, 0.0, 0.0, 0.0, 0.0, 0.0],
            p: [0.0; 2],
        },
        focal_px: [20.0, 20.0],
        centre_px: [32.0, 32.0],
        size_px: [64, 64],
    });
    let words = Optics::new(&folded, None, 64, 64).unwrap_err().to_string();
    assert!(words.contains("folds back 46.5 degrees"), "{words}");
}

#[test]
fn a_calibration_scales_with_the_picture_and_rejects_other_proportions() {
    let lens = Lens::Calibrated(Calibration {
        distortion: Distortion::Brown {
            k: [-0.2, 0.05, 0.0, 0.0, 0.0, 0.0],
            p: [1e-3, -2e-3],
        },
        focal_px: [800.0, 810.0],
        centre_px: [645.5, 350.5],
        size_px: [1280, 720],
    });
    let full = Optics::new(&lens, None, 1280, 720).unwrap();
    let half = Optics::new(&lens, None, 640, 360).unwrap();
    let (a, b) = (
        full.direction([100.0, 640.0]),
        half.direction([50.0, 320.0]),
    );
    for (a, b) in a.unwrap().iter().zip(b.unwrap()) {
        assert!((a - b).abs() < 1e-14);
    }
    assert!((full.fov_rad() - half.fov_rad()).abs() < 1e-14);
    let words = Optics::new(&lens, None, 512, 512).unwrap_err().to_string();
    assert!(
        words.contains("1280 x 720") && words.contains("512 x 288"),
        "{words}"
    );
    assert!(Optics::new(&lens, Some(1.0), 640, 360).is_err());
    for broken in [
        Calibration {
            focal_px: [0.0, 800.0],
            ..calibration_of(&lens)
        },
        Calibration {
            centre_px: [-3.0, 300.0],
            ..calibration_of(&lens)
        },
        Calibration {
            size_px: [0, 720],
            ..calibration_of(&lens)
        },
        Calibration {
            centre_px: [f64::NAN, 300.0],
            ..calibration_of(&lens)
        },
    ] {
        assert!(Optics::new(&Lens::Calibrated(broken), None, 1280, 720).is_err());
    }
}

fn calibration_of(lens: &Lens) -> Calibration {
    match lens {
        Lens::Calibrated(calibration) => *calibration,
        _ => unreachable!("made as a calibration"),
    }
}

#[test]
fn the_natural_light_of_a_pinhole_falls_with_the_fourth_power_of_the_cosine() {
    let optics = Optics::new(&Lens::Pinhole, Some(2.0), 64, 64).unwrap();
    for angle in [0.1, 0.5, 0.9f64] {
        let light = optics.natural_light([angle.sin(), 0.0, angle.cos()]);
        assert!((light - angle.cos().powi(4)).abs() < 1e-12);
    }
    // An equidistant lens distributes its pixels evenly over the angle and loses less light.
    let fish = Optics::new(&Lens::Equidistant, Some(2.0), 64, 64).unwrap();
    assert!(fish.natural_light([0.8, 0.0, 0.6]) > optics.natural_light([0.8, 0.0, 0.6]));
}

fn any_lens() -> impl Strategy<Value = Lens> {
    prop_oneof![
        Just(Lens::Pinhole),
        Just(Lens::Equidistant),
        (-0.4f64..0.4, -0.1f64..0.1).prop_map(|(k1, k2)| brown(k1, k2, 0.0, 0.0)),
        (-0.1f64..0.3, 0.0f64..0.05, -0.01f64..0.01, -0.01f64..0.01)
            .prop_map(|(k1, k2, p1, p2)| brown(k1, k2, p1, p2)),
        (prop::array::uniform6(-0.1f64..0.2))
            .prop_map(|k| Lens::Distorted(Distortion::Brown { k, p: [0.0; 2] })),
        prop::array::uniform4(-0.05f64..0.2)
            .prop_map(|k| Lens::Distorted(Distortion::Fisheye { k })),
    ]
}

proptest! {
    #[test]
    fn pixel_and_direction_conversions_are_inverse(
        lens in any_lens(),
        fov_deg in 1.0f64..170.0,
        (width, height) in (16usize..900, 16usize..900),
        at in prop::array::uniform2(0.0f64..1.0),
    ) {
        let Ok(optics) = Optics::new(&lens, Some(fov_deg.to_radians()), width, height) else {
            return Ok(());
        };
        let pixel = [at[0] * width as f64, at[1] * height as f64];
        if let Some(d) = optics.direction(pixel) {
            prop_assert!((crate::length(d) - 1.0).abs() < 1e-12);
            let back = optics.pixel(d);
            // A point at the angle at which the model folds back may be on either side of the fold.
            if let Some(back) = back {
                // The tolerance is 1e-6 px, because near a fold a pixel's direction is badly conditioned; elsewhere the
                // error is 1e-10.
                prop_assert!((back[0] - pixel[0]).abs() + (back[1] - pixel[1]).abs() < 1e-6, "{pixel:?} {back:?}");
            } else {
                let angle = libm::atan2((d[0] * d[0] + d[1] * d[1]).sqrt(), d[2]);
                prop_assert!(angle > optics.limit_rad() - 1e-9);
            }
        } else {
            // A pixel without a ray must be outside the image circle.
            let side = width.min(height) as f64;
            let away = ((pixel[0] - width as f64 / 2.0).powi(2) + (pixel[1] - height as f64 / 2.0).powi(2)).sqrt();
            prop_assert!(away > side / 2.0 * (1.0 - 1e-6));
        }
    }
}
