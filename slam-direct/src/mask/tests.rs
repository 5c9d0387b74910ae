use super::*;

const SIZE: (usize, usize) = (320, 240);

/// A world of blobs, moved by so many pixels, behind what `front` shows where it is something.
fn view(shift: f32, front: impl Fn(usize, usize) -> Option<u8>) -> Pyramid {
    let mut image = GrayImage::filled(SIZE.0, SIZE.1, 0);
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (u, v) = (x as f32 + shift, y as f32 + 0.3 * shift);
            let world = (0.31 * u + 0.9 * (0.11 * v).sin()).sin() + (0.27 * v + (0.07 * u).cos()).sin();
            image.set(x, y, front(x, y).unwrap_or((127.0 + 25.0 * world) as u8));
        }
    }
    Pyramid::new(image, 3)
}

fn bars(_: usize, y: usize) -> Option<u8> {
    (!(20..100).contains(&y)).then_some(0)
}

const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 300.0, fy: 300.0, cx: 159.5, cy: 119.5 };

/// The rotation of a camera that sees what is far away moved by so many pixels to the left and up.
fn turned(shift: f32) -> Option<UnitQuaternion<f64>> {
    let angle = f64::from(shift) / CAMERA.fx;
    Some(UnitQuaternion::from_euler_angles(0.3 * angle, -angle, 0.0))
}

fn look(learner: &mut MaskLearner, shift: f32, front: impl Fn(usize, usize) -> Option<u8>) -> bool {
    learner.look(&view(shift, front), &CAMERA, turned(shift))
}

fn learnt(frames: usize, front: impl Fn(usize, usize) -> Option<u8> + Copy, step: f32) -> Arc<Mask> {
    let mut learner = MaskLearner::default();
    for i in 0..frames {
        look(&mut learner, step * (i as f32 + 3.0 * (i as f32).sin()), front);
    }
    Arc::clone(learner.mask())
}

#[test]
fn what_moves_with_the_camera_is_covered_and_the_world_is_not() {
    let mask = learnt(40, bars, 5.0);
    let along = |y: usize| (4..156).filter(|&x| mask.covers(x, y)).count();
    assert!(along(20) > 130 && along(99) > 130, "{} {}", along(20), along(99));
    let inside: usize = (30..90).map(along).sum();
    assert!(inside < 60 * 152 / 100, "{inside}");
    assert!(!mask.covers_at([-1.0, 20.0]) && !mask.covers_at([1e6, 20.0]));
}

#[test]
fn a_world_without_is_not_covered() {
    assert!(learnt(60, |_, _| None, 5.0).covered.iter().filter(|c| **c).count() < 20);
}

#[test]
fn a_camera_that_stands_learns_nothing() {
    assert!(learnt(60, |_, _| None, 0.0).is_empty());
    // Someone walks by.
    let mut learner = MaskLearner::default();
    for i in 0..60 {
        let passer = move |x: usize, y: usize| {
            let behind = x.checked_sub(3 * i).filter(|behind| *behind < 30);
            behind.map(|behind| ((behind * 37 + y * 53) % 200) as u8)
        };
        look(&mut learner, 0.0, passer);
    }
    assert!(learner.mask().is_empty());
}

#[test]
fn a_given_mask_stays_in_force_next_to_what_is_found() {
    let mut unused = Image::filled(SIZE.0, SIZE.1, false);
    (0..SIZE.1).for_each(|y| (300..SIZE.0).for_each(|x| unused.set(x, y, true)));
    let mut learner = MaskLearner::default();
    learner.leave_out(Arc::new(unused));
    assert_eq!(learner.left_out(&CAMERA), LeftOut { given: 20.0 / 320.0, found: 0.0 });
    let at = |i: usize| 5.0 * (i as f32 + 3.0 * (i as f32).sin());
    let known = (0..40).filter(|&i| look(&mut learner, at(i), bars)).count();
    assert_eq!(known, 1, "the mask that was given is not what was found");
    let mask = Arc::clone(learner.mask());
    let along = |y: usize| (4..156).filter(|&x| mask.covers(x, y)).count();
    assert!((0..SIZE.1).all(|y| mask.covers(310, y)) && along(20) > 130 && along(60) < 20);
    let LeftOut { given, found } = learner.left_out(&CAMERA);
    let counted = (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y)));
    let covered = counted.filter(|&(x, y)| mask.covers(x, y)).count() as f64 / (SIZE.0 * SIZE.1) as f64;
    assert!(
        given == 20.0 / 320.0 && found > 0.01 && (given + found - covered).abs() < 1e-9,
        "{given} {found}"
    );
    // What is under it is not looked at.
    assert!(
        mask.covered
            .iter()
            .enumerate()
            .all(|(at, covered)| !covered || (at % mask.width) << mask.level < 304)
    );
}

#[test]
fn what_is_gone_is_forgotten() {
    let mut learner = MaskLearner::default();
    let at = |i: usize| 5.0 * (i as f32 + 3.0 * (i as f32).sin());
    let known = (0..30).filter(|&i| look(&mut learner, at(i), bars)).count();
    assert_eq!(known, 1);
    (30..230).for_each(|i| assert!(!look(&mut learner, at(i), |_, _| None)));
    let left = learner.mask().covered.iter().filter(|covered| **covered).count();
    assert!(left < 20, "{left}");
}
