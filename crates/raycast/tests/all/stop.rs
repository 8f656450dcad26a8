//! Tests that a cast can be cancelled, and that a cast with an unused cancel flag gives the same picture.

use std::sync::atomic::AtomicBool;

use crate::scene::{Scene, options};
use carina_grid::VolumeView;
use carina_raycast::{CastStats, Frame, InstructionSet, Method, cast_rows, cast_rows_until};

fn cast(simd: InstructionSet, stop: Option<bool>) -> Option<(Vec<u8>, CastStats)> {
    let mut scene = Scene::fixed([1.0, -2.0, 0.5], [0.2, 0.9, 0.3]);
    scene.resize(37, 29);
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let frame = Frame::new(volume, &table, scene.camera.clone(), options(true, false)).unwrap();
    match stop {
        None => Some(cast_rows(&frame, Method::Brute, 0..29, simd).unwrap()),
        Some(set) => {
            let stop = AtomicBool::new(set);
            cast_rows_until(&frame, Method::Brute, 0..29, simd, &stop).unwrap()
        }
    }
}

#[test]
fn an_unused_stop_flag_does_not_change_the_picture() {
    for simd in InstructionSet::available() {
        assert!(
            cast(simd, Some(false)) == cast(simd, None),
            "{}",
            simd.name()
        );
    }
}

#[test]
fn a_stopped_cast_returns_none() {
    for simd in InstructionSet::available() {
        assert!(cast(simd, Some(true)).is_none(), "{}", simd.name());
    }
}
