//! Stated uncertainties of poses, scales and depths are true: a short form of the example `nees`.

mod measure;
mod points;
mod scale;

use loopbox_tests::{Recording, World, trajectory};
use measure::{Nees, mean, measure};
use points::DepthErrors;
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

#[test]
fn depths_err_by_no_more_than_is_stated_from_what_their_patches_show() {
    let path = trajectory::walk(90, 30.0, 4);
    let world = World::yard(4);
    let recording = Recording::render(&world, Recording::SMALL_CAMERA, &path, 30.0).with_noise(6.0, 4);
    let mut errors = DepthErrors::default();
    errors.add(&recording, &world);
    assert!(errors.dense.len() > 20_000 && errors.confirmed.len() > 500, "{} depths", errors.dense.len());
    let within = |errors: &[points::Error], k: usize| {
        errors.iter().filter(|error| error[k] < 2.0).count() as f64 / errors.len() as f64
    };
    let [dense, at_patch] = [within(&errors.dense, 0), within(&errors.confirmed, 1)];
    assert!(dense > 0.92, "{dense} of the semi-dense depths lie within two deviations, 0.95 is exact");
    assert!(at_patch > 0.9, "{at_patch} of the points lie within two deviations of what is in their patch");
    let nees = mean(errors.dense.iter().map(|error| error[1] * error[1]));
    assert!((0.02..2.0).contains(&nees), "the mean NEES of depths is {nees} in their patches");
}
