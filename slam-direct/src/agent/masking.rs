//! The part of the images that an agent ignores: the given mask, and what it finds to move with the camera.

use super::{Agent, AgentError};
use crate::mask::LeftOut;
use geometry::Image;
use std::sync::Arc;

impl Agent {
    /// Ignores these pixels of the images, besides those that move with the camera: no points and no depth there. To
    /// be called before the first frame.
    ///
    /// # Errors
    /// When the mask is not of the camera's size.
    pub fn leave_out(&mut self, unused: Arc<Image<bool>>) -> Result<(), AgentError> {
        let (mask, camera) = ((unused.width(), unused.height()), (self.camera.width, self.camera.height));
        if mask != camera {
            return Err(AgentError::MaskSize { mask, camera });
        }
        self.learner.leave_out(unused);
        self.view.mask = Arc::clone(self.learner.mask());
        if let Some(mapper) = &mut self.mapper {
            mapper.local.mask = Arc::clone(self.learner.mask());
        }
        Ok(())
    }

    /// How much of the images is left out.
    pub fn left_out(&self) -> LeftOut {
        self.learner.left_out(&self.camera)
    }
}
