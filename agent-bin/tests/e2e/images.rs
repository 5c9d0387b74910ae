//! Images that show less than they should.

use crate::support::{Case, drive, hand_held, repaint};
use geometry::GrayImage;
use std::sync::Arc;

#[test]
fn black_frames_in_the_middle_do_not_end_the_map() {
    let mut recording = drive();
    repaint(&mut recording, 40..46, |_, image| GrayImage::filled(image.width(), image.height(), 0));
    let case = Case::new(&recording);
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 12);
}

/// The camera's driver hangs for a quarter of a second while the camera moves on.
#[test]
fn frozen_frames_do_not_end_the_map() {
    let mut recording = drive();
    let frozen = Arc::clone(&recording.shots[39].image);
    let pose = recording.shots[39].world_from_camera;
    for shot in &mut recording.shots[40..48] {
        (shot.image, shot.world_from_camera) = (Arc::clone(&frozen), pose);
    }
    let case = Case::new(&recording);
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 12);
}

#[test]
fn gain_that_jumps_by_forty_per_cent_is_followed() {
    let mut recording = hand_held(90);
    repaint(&mut recording, 0..90, |i, image| {
        let gain = [1.0, 1.4, 1.0, 0.6][i / 10 % 4];
        let mut image = image.clone();
        for value in image.data_mut() {
            *value = (*value as f32 * gain).round() as u8;
        }
        image
    });
    let case = Case::new(&recording);
    let outcome = case.run(&[]);
    case.assert_mapped(&outcome, 4);
}
