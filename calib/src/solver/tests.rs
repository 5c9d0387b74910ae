//! The solver against corners made from a known camera.

use super::model::tests::{SIZE, cameras};
use super::*;
use crate::Board;
use geometry::{Camera, Random, Se3};
use nalgebra::{UnitQuaternion, Vector3};

/// Random numbers, and normal ones from them by Box and Muller.
pub(crate) struct Noise(Random);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(Random::new(seed))
    }

    pub fn uniform(&mut self) -> f64 {
        self.0.unit()
    }

    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().max(1e-300).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

pub(crate) fn board() -> Board {
    "chessboard:9x6:0.03".parse().unwrap()
}

/// camera_from_board with the board's middle at `position`, turned by `tilt` (rotation vector, radians).
pub(crate) fn placed(board: &Board, position: [f64; 3], tilt: [f64; 3]) -> Se3 {
    let points = board.points();
    let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(tilt));
    Se3::new(rotation, Vector3::from(position) - rotation * middle)
}

/// What the camera finds of the board, with noise of `sigma` pixels in each direction.
pub(crate) fn seen(camera: &Camera, board: &Board, pose: &Se3, sigma: f64, noise: &mut Noise) -> View {
    let points = board.points();
    let corners = points.iter().enumerate().filter_map(|(index, point)| {
        let pixel = camera.project(&(*pose * *point)).filter(|pixel| camera.contains(pixel))?;
        Some(Corner { index, pixel: pixel + Vector2::new(noise.normal(), noise.normal()) * sigma })
    });
    View { name: String::new(), corners: corners.collect() }
}

/// A usual set of views: all over the image, tilted each way, near and far.
pub(crate) fn usual_poses(board: &Board) -> Vec<Se3> {
    let mut noise = Noise::new(5);
    (0..14)
        .map(|i| {
            let distance = 0.32 + 0.02 * (i % 7) as f64;
            let across = [(i % 3) as f64 - 1.0, (i / 3 % 3) as f64 - 1.0];
            let position = [0.16 * across[0] * distance / 0.4, 0.08 * across[1] * distance / 0.4, distance];
            let tilt = std::array::from_fn(|_| (noise.uniform() - 0.5) * 1.2);
            placed(board, position, tilt)
        })
        .collect()
}

fn usual_views(camera: &Camera, sigma: f64, seed: u64) -> Vec<View> {
    let (board, mut noise) = (board(), Noise::new(seed));
    usual_poses(&board).iter().map(|pose| seen(camera, &board, pose, sigma, &mut noise)).collect()
}

fn solved(views: &[View], model: LensModel) -> Result<Calibration, Refusal> {
    calibrate(&board(), views, SIZE, model, &SolverParams::default())
}

#[test]
fn every_model_is_found_again() {
    for (model, camera) in cameras() {
        let found = solved(&usual_views(&camera, 0.2, 1), model).unwrap();
        let truth = model.parameters(&camera);
        for (i, estimate) in found.estimates.iter().enumerate() {
            let error = (estimate.value - truth[i]) / estimate.sigma;
            assert!(error.abs() < 3.5, "{model}: {} is {error:.1} sigma off", estimate.name);
        }
        assert!((found.rms - 0.2 * 2f64.sqrt()).abs() < 0.03, "{model}: rms {}", found.rms);
        assert!(found.views.iter().all(|view| view.rejected.is_none()));
    }
}

#[test]
fn without_noise_the_camera_is_exact() {
    for (model, camera) in cameras() {
        let found = solved(&usual_views(&camera, 0.0, 1), model).unwrap();
        let difference = model.parameters(&found.camera) - model.parameters(&camera);
        assert!(difference.norm() < 1e-5, "{model}: {difference}");
    }
}

/// Over many draws the errors must scatter as the covariance says (NEES, Bar-Shalom 2001, §5.4).
#[test]
fn uncertainty_is_consistent() {
    const DRAWS: usize = 60;
    for (model, camera) in [cameras()[1], cameras()[3]] {
        let (count, truth) = (model.parameter_count(), model.parameters(&camera));
        let nees = (0..DRAWS).map(|draw| {
            let found = solved(&usual_views(&camera, 0.3, 100 + draw as u64), model).unwrap();
            let error = (model.parameters(&found.camera) - truth).rows(0, count).into_owned();
            error.dot(&(found.covariance.clone().try_inverse().unwrap() * &error))
        });
        let mean = nees.sum::<f64>() / DRAWS as f64;
        // χ² of `count` degrees: the mean of the draws deviates by √(2 count / DRAWS); four of these.
        let slack = 4.0 * (2.0 * count as f64 / DRAWS as f64).sqrt();
        assert!((mean - count as f64).abs() < slack, "{model}: NEES {mean:.2} of {count} ± {slack:.2}");
    }
}

/// A lens with a third radial term, fitted without it: the fit depends on where the views lie, and two halves of them
/// must differ by about as much as their uncertainties say.
#[test]
fn uncertainty_holds_for_a_lens_that_the_model_does_not_fit() {
    let (_, camera) = cameras()[3];
    let (board, mut noise) = (board(), Noise::new(11));
    let mut place = |from: f64, to: f64| from + (to - from) * noise.uniform();
    let poses: Vec<Se3> = (0..48)
        .map(|_| {
            let position = [place(-0.2, 0.2), place(-0.12, 0.12), place(0.3, 0.5)];
            placed(&board, position, std::array::from_fn(|_| place(-0.6, 0.6)))
        })
        .collect();
    let mut noise = Noise::new(12);
    let views: Vec<View> = poses.iter().map(|pose| seen(&camera, &board, pose, 0.05, &mut noise)).collect();
    let whole = solved(&views, LensModel::RadTan4).unwrap();
    assert!(whole.rms > 1.3 * whole.most_flexible.1, "{} and {:?}", whole.rms, whole.most_flexible);
    let found: Vec<Calibration> =
        views.chunks(12).map(|part| solved(part, LensModel::RadTan4).unwrap()).collect();
    let mut squares = Vec::new();
    for (a, b) in [(0, 1), (1, 2), (2, 3), (3, 0)] {
        for (one, other) in found[a].estimates.iter().zip(&found[b].estimates) {
            squares.push((one.value - other.value).powi(2) / (one.sigma.powi(2) + other.sigma.powi(2)));
        }
    }
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!((0.2..3.0).contains(&mean), "{mean:.2} times the variance that was said");
}

#[test]
fn a_check_tells_the_true_camera_from_another_one() {
    for (model, camera) in cameras() {
        let views = usual_views(&camera, 0.2, 6);
        let right = check(&board(), &views, &camera).unwrap();
        assert!((right.rms() - 0.2 * 2f64.sqrt()).abs() < 0.03, "{model}: {}", right.rms());
        assert!((right.median() - 0.235).abs() < 0.03, "{model}: {}", right.median());
        let mut parameters = model.parameters(&camera);
        parameters[1] *= 1.02;
        let wrong = check(&board(), &views, &model.camera(SIZE, &parameters).unwrap()).unwrap();
        assert!(wrong.rms() > 1.5 * right.rms(), "{model}: {} and {}", wrong.rms(), right.rms());
        assert_eq!(wrong.corner_count(), views.iter().map(|view| view.corners.len()).sum::<usize>());
    }
}

#[test]
fn wrong_corners_and_a_wrong_view_are_set_aside() {
    let (model, camera) = cameras()[1];
    let mut views = usual_views(&camera, 0.2, 3);
    let clean = solved(&views, model).unwrap();
    for (k, view) in views.iter_mut().take(5).enumerate() {
        view.corners[7 * k].pixel += Vector2::new(6.0, -4.0);
    }
    let mut noise = Noise::new(9);
    for corner in &mut views[9].corners {
        corner.pixel += Vector2::new(noise.normal(), noise.normal()) * 3.0;
    }
    let found = solved(&views, model).unwrap();
    for (k, view) in found.views.iter().take(5).enumerate() {
        let corners = &view.corners;
        assert!(!corners[7 * k].used && corners.iter().filter(|corner| !corner.used).count() <= 2);
    }
    assert!(found.views[9].rejected.as_ref().unwrap().contains("rms"), "{:?}", found.views[9].rejected);
    assert_eq!(found.views.iter().filter(|view| view.rejected.is_some()).count(), 1);
    assert!((found.estimates[0].value - clean.estimates[0].value).abs() < clean.estimates[0].sigma);
    assert!(found.rms < 0.32 && found.rms_of_all > 0.5);
}

#[test]
fn views_from_one_direction_are_refused() {
    let (model, camera) = cameras()[1];
    let (board, mut noise) = (board(), Noise::new(2));
    let mut view = |position: [f64; 3], tilt: [f64; 3]| {
        seen(&camera, &board, &placed(&board, position, tilt), 0.2, &mut noise)
    };
    let flat: Vec<View> =
        (0..8).map(|i| view([0.03 * i as f64 - 0.1, 0.0, 0.5], [0.01, 0.01 * i as f64, 0.0])).collect();
    let message = solved(&flat, model).unwrap_err().to_string();
    assert!(message.contains("one direction") || message.contains("tilts"), "{message}");
    assert!(message.contains("hint: add images"), "{message}");
    let message = solved(&flat[..2], model).unwrap_err().to_string();
    assert!(message.contains("2 of 2 images") && message.contains("3 are needed"), "{message}");
}

#[test]
fn corners_that_make_no_sense_are_refused() {
    let (model, camera) = cameras()[1];
    let mut views = usual_views(&camera, 0.2, 4);
    views[3].corners[0].index = 999;
    assert!(matches!(solved(&views, model), Err(Refusal::NoSuchCorner { index: 999, .. })));
    let mut noise = Noise::new(1);
    let random = (0..5).map(|_| View {
        name: String::new(),
        corners: (0..54)
            .map(|index| Corner {
                index,
                pixel: Vector2::new(752.0 * noise.uniform(), 480.0 * noise.uniform()),
            })
            .collect(),
    });
    let message = solved(&random.collect::<Vec<_>>(), model).unwrap_err().to_string();
    assert!(message.contains("hint"), "{message}");
    let mut line = usual_views(&camera, 0.2, 4);
    line.iter_mut().for_each(|view| view.corners.truncate(8));
    assert!(matches!(solved(&line, model), Err(Refusal::TooFewViews { usable: 0, .. })));
}
