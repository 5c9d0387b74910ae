//! Stated uncertainties of poses and scales are true: a short form of the example `nees`.

mod measure;
mod scale;

use loopbox_tests::{Recording, World, trajectory};
use measure::{Nees, mean, measure};
use scale::measure_scale;

#[test]
fn poses_err_as_much_as_is_stated() {
    let recordings = [1, 2, 3].map(|seed| {
        let path = trajectory::walk(90, 30.0, seed);
        Recording::render(&World::yard(seed), Recording::SMALL_CAMERA, &path, 30.0).with_noise(2.0, seed)
    });
    let all: Vec<Nees> = recordings.iter().flat_map(measure).collect();
    assert!(all.len() > 150, "{} frames were tracked", all.len());
    for (what, nees) in [
        ("poses", mean(all.iter().map(|nees| nees.pose))),
        ("positions", mean(all.iter().map(|nees| nees.position))),
        ("rotations", mean(all.iter().map(|nees| nees.rotation))),
    ] {
        assert!((0.5..2.0).contains(&nees), "the mean NEES of {what} is {nees}, 1 is exact");
    }
}

#[test]
fn scales_err_by_no_more_than_is_stated() {
    let path = trajectory::walk(90, 30.0, 4);
    let world = World::yard(4);
    let recording = Recording::render(&world, Recording::SMALL_CAMERA, &path, 30.0).with_noise(6.0, 4);
    let cuts = measure_scale(&recording, &world);
    assert!(cuts.len() >= 5, "{} cuts tell a scale", cuts.len());
    assert!(cuts.iter().all(|[_, deviation]| *deviation < 0.02), "{cuts:?}");
    let nees = mean(cuts.iter().map(|[error, deviation]| (error / deviation).powi(2)));
    assert!((0.02..2.0).contains(&nees), "the mean NEES of scales is {nees}, 1 is exact: {cuts:?}");
}
