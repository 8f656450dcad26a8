//! Tests of pictures through lenses: they are equal from every caster, and each pixel shows the scene in its direction.

use std::sync::Arc;

use crate::scene::{Scene, any_scene, options};
use carina_grid::{
    Affine, Camera, Distortion, FieldShape, ImageField, Lens, LensRays, Optics, VolumeView, cross,
    unit,
};
use carina_isoregion::{cell_map, class_labels};
use carina_raycast::{CastStats, Frame, InstructionSet, Method, cast_rows};
use proptest::prelude::*;

fn cast(
    scene: &Scene,
    camera: &Camera,
    method: Method<'_>,
    shaded: bool,
    simd: InstructionSet,
) -> (Vec<u8>, CastStats) {
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let mut settings = options(shaded, false);
    settings.background = [0.2, 0.4, 0.6];
    let frame = Frame::new(volume, &table, camera.clone(), settings).unwrap();
    cast_rows(&frame, method, 0..camera.height(), simd).unwrap()
}

fn any_lens() -> impl Strategy<Value = (Lens, f64)> {
    let brown = |k1, k2| Distortion::Brown {
        k: [k1, k2, 0.0, 0.0, 0.0, 0.0],
        p: [1e-3, -2e-3],
    };
    prop_oneof![
        (0.5f64..2.9).prop_map(|fov| (Lens::Pinhole, fov)),
        (0.5f64..2.9).prop_map(|fov| (Lens::Equidistant, fov)),
        (0.0f64..0.3, 0.5f64..2.9).prop_map(|(k1, fov)| {
            let k = [k1, 0.0, 0.0, 0.0];
            (Lens::Distorted(Distortion::Fisheye { k }), fov)
        }),
        (-0.2f64..0.1, 0.0f64..0.01, 0.5f64..1.4)
            .prop_map(move |(k1, k2, fov)| (Lens::Distorted(brown(k1, k2)), fov)),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn pictures_through_a_lens_are_equal_for_every_caster(
        scene in any_scene(),
        (lens, fov) in any_lens(),
        (width, height) in (1usize..40, 1usize..24),
        shape in prop_oneof![Just(FieldShape::Full), Just(FieldShape::Round), Just(FieldShape::Octagon)],
        shaded in any::<bool>(),
        leaps in any::<bool>(),
    ) {
        let field = ImageField { shape, edge_px: 1.5, vignette: 0.5 };
        let Ok(rays) = Optics::new(&lens, Some(fov), width, height).and_then(|optics| LensRays::build(optics, &field)) else {
            return Ok(());
        };
        let camera = Camera::with_lens(*scene.camera.lps_from_camera(), Arc::new(rays)).unwrap();
        let entries = scene.transfer(false).range(-1100, 3100);
        let labels = class_labels(&scene.hu, -1100, &entries, true).unwrap().labels;
        let radius = cell_map(&labels, scene.grid.shape_zyx()).unwrap();
        let brute = cast(&scene, &camera, Method::Brute, shaded, InstructionSet::Portable);
        let method = if leaps { Method::LeapTransparent(&radius) } else { Method::Brute };
        let truth = cast(&scene, &camera, method, shaded, InstructionSet::Portable);
        prop_assert_eq!(&brute.0, &truth.0);
        for simd in InstructionSet::available() {
            prop_assert_eq!(&cast(&scene, &camera, method, shaded, simd), &truth, "{}", simd.name());
        }
        // Pixels for which the lens or the mask has no ray show the background.
        let rays = camera.lens_rays().unwrap();
        for (n, pixel) in truth.0.chunks_exact(3).enumerate() {
            if rays.direction(n % width, n / width) == [0.0; 3] {
                prop_assert_eq!(pixel, &[51, 102, 153]);
            }
        }
    }

    #[test]
    fn a_pixel_of_a_lens_equals_that_of_a_pinhole_in_its_direction(
        scene in any_scene(),
        (lens, fov) in any_lens(),
        at in prop::array::uniform2(0.0f64..1.0),
    ) {
        let Ok(rays) = Optics::new(&lens, Some(fov), 23, 19).and_then(|optics| LensRays::build(optics, &ImageField::FULL)) else {
            return Ok(());
        };
        let (column, row) = ((at[0] * 23.0) as usize, (at[1] * 19.0) as usize);
        let dir = rays.direction(column, row).map(f64::from);
        let Some(forward) = unit(dir) else {
            return Ok(());
        };
        let pose = *scene.camera.lps_from_camera();
        let camera = Camera::with_lens(pose, Arc::new(rays)).unwrap();
        let (picture, _) = cast(&scene, &camera, Method::Brute, false, InstructionSet::Portable);
        // The expected pixel is that of a pinhole camera of one pixel with a narrow field that looks in the same
        // direction, computed from the formula and not from the lens.
        let aside = if forward[0].abs() < 0.7 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let right = unit(cross(aside, forward)).unwrap();
        let down = cross(forward, right);
        let turned = Affine::from_columns(right, down, forward, [0.0; 3]);
        let single = Camera::new(pose.after(&turned), 0.1, 1, 1).unwrap();
        let (pixel, _) = cast(&scene, &single, Method::Brute, false, InstructionSet::Portable);
        let found = &picture[(row * 23 + column) * 3..][..3];
        for (a, b) in found.iter().zip(&pixel) {
            // Directions are stored in f32, so samples move by some 1e-5 voxels. Such a displacement changes a pixel by
            // one level, and by more at a jump of the transfer function within one HU.
            prop_assert!(a.abs_diff(*b) <= 12, "{found:?} for {pixel:?}");
        }
    }
}
