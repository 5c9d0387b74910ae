//! Stated uncertainties of poses are true: a short form of the example `nees`.

mod measure;

use loopbox_tests::{Recording, World, trajectory};
use measure::{Nees, mean, measure};

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
