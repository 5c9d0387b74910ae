//! Detects a rolling shutter while the camera rotates.
//!
//! A map that is made of images that a rolling shutter bends takes the bending for depth, sooner the less the camera
//! translates, and then agrees with it. So patches are followed for some frames by themselves, as at the start, and
//! their result does not depend on the map.

use super::Agent;
use crate::bootstrap::{Bootstrap, Turned};
use geometry::Pyramid;
use geometry::sensor::Twist;

/// Readout time of a usual rolling shutter, seconds.
const USUAL_READOUT: f64 = 0.02;
/// By which share of its width an image must be bent by it for the question to be worth asking.
const MUCH: f64 = 0.01;
/// How often it is asked; who is not found to have a rolling shutter by then has none.
const QUESTIONS: usize = 8;

/// Whether the camera has a rolling shutter, as it is being asked.
#[derive(Default)]
pub(super) struct ShutterQuestion {
    turning: Option<Box<Bootstrap>>,
    asked: usize,
    /// The readout times that were found, until the mapper is told.
    pub answer: Option<[f64; 2]>,
}

impl Agent {
    /// Takes a tracked frame into the question; `motion` is the camera's since the frame before.
    pub(super) fn ask_for_shutter(
        &mut self,
        pyramid: &Pyramid,
        timestamp: f64,
        frame_index: u64,
        motion: &Twist,
    ) {
        let is_open = self.shutter.asked < QUESTIONS && self.shutter.answer.is_none();
        let can_be_learnt = self.resumed.is_none() && self.params.mapping.readout_sigma > 0.0;
        if !is_open || !can_be_learnt || self.view.sensor.is_rolling() {
            self.shutter.turning = None;
            return;
        }
        match self.shutter.turning.take() {
            Some(mut turning) => {
                match turning.track_rotation(pyramid, timestamp, frame_index, &self.params) {
                    Turned::On => self.shutter.turning = Some(turning),
                    Turned::Nothing => {}
                    Turned::Readout(readout) => {
                        self.shutter.asked += 1;
                        self.shutter.answer = Some(readout).filter(|readout| *readout != [0.0; 2]);
                    }
                }
            }
            None => {
                let rotation = motion.fixed_rows::<3>(3).norm() * USUAL_READOUT;
                if rotation * self.camera.fx > MUCH * self.camera.width as f64 {
                    let (mask, block) = (self.learner.mask(), 2 * self.params.bootstrap.block);
                    let (sensor, pyramid) = (self.view.sensor, pyramid.clone());
                    let turning = Bootstrap::new(sensor, pyramid, timestamp, frame_index, mask, block);
                    self.shutter.turning = turning.map(Box::new);
                }
            }
        }
    }
}
