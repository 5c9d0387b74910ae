//! The lens of a live camera that has no calibration: maps of what it sees now, with a usual lens first.

use super::searching::Search;
use super::{FoundLens, USUAL, USUAL_SPREAD, centred, guesses, map_with};
use crate::run::{Progress, RunOptions};
use anyhow::{Result, bail};
use geometry::Camera;
use sources::correction::{doubled_camera, halvings};
use sources::{FrameSource, Stop};
use std::cell::RefCell;

/// Images that a camera may give which cannot be read before it is given up.
const UNREADABLE: usize = 100;

/// Finds the lens of a live source from the images that come now; `fov` is its horizontal field of view in degrees, where the user knows
/// that.
///
/// Makes maps of these images as [`find_lens`](super::find_lens) does of a recording's first part, each of what the camera sees after the one before. Where no
/// map tells the lens, a usual one is taken: what it is known to is said with it.
///
/// # Errors
/// When the source gives no image that can be read, or a mask does not fit.
pub fn find_live_lens(
    source: &mut dyn FrameSource,
    fov: Option<f64>,
    options: &RunOptions,
    stop: &Stop,
    progress: &dyn Progress,
) -> Result<FoundLens> {
    let frames = std::iter::from_fn(|| source.next_frame()).take(UNREADABLE);
    let Some(image) = frames.filter_map(|frame| frame.picture.into_grey().ok()).next() else {
        bail!("{}: the camera gives no image to find its lens from", source.info().path.display())
    };
    let whole = (image.width(), image.height());
    let times = halvings(whole.0, options.camera.max_width);
    let mask = options.camera.drawn_mask(whole)?;
    let source = RefCell::new(source);
    let map = |lens: &Camera, round: usize| {
        progress
            .stage(&format!("finding the lens, round {}: move the camera sideways and turn it", round + 1));
        let lens = (lens, times, mask.as_ref());
        map_with(lens, &mut **source.borrow_mut(), &options.params, stop, &|frame| progress.looked_at(frame))
    };
    let stated = source.borrow().stated_focal(whole);
    let search = Search { whole, times, params: &options.params, map_with: &map, stop, is_repeated: false };
    match search.by(guesses(fov, stated, whole, times))? {
        Ok(found) => Ok(found),
        Err(_) => {
            let (width, height) = (whole.0 >> times, whole.1 >> times);
            let usual = centred(USUAL[0] * width.max(height) as f64, (width, height))?;
            let camera = doubled_camera(&usual, whole, times)?;
            Ok(FoundLens { camera, focal_deviation: USUAL_SPREAD, stated: None })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::Silent;
    use sources::pictures::{Picture, RawPicture};
    use sources::{SourceFrame, SourceInfo};

    /// A camera that shows one even colour for some frames.
    struct Even {
        info: SourceInfo,
        left: u64,
    }

    impl FrameSource for Even {
        fn info(&self) -> &SourceInfo {
            &self.info
        }

        fn next_frame(&mut self) -> Option<SourceFrame> {
            self.left = self.left.checked_sub(1)?;
            let index = 100 - self.left;
            let picture = Picture::Raw(RawPicture {
                width: 160,
                height: 120,
                step: 160,
                encoding: "mono8".into(),
                big_endian: false,
                data: vec![90; 160 * 120],
            });
            Some(SourceFrame { index, timestamp: index as f64 / 30.0, captured: None, picture })
        }

        fn is_live(&self) -> bool {
            true
        }
    }

    fn even(left: u64) -> Even {
        Even { info: SourceInfo::new("camera", "/dev/video9"), left }
    }

    #[test]
    fn a_camera_without_texture_gets_a_usual_lens_that_is_reported_as_a_guess() {
        let options = RunOptions::to("unused");
        let found = find_live_lens(&mut even(100), None, &options, &Stop::default(), &Silent).unwrap();
        assert!(!found.is_determined() && (found.camera.intrinsics().fx - 128.0).abs() < 1e-9);
        assert!(found.text().contains("a guess"), "{}", found.text());
        let given = find_live_lens(&mut even(100), Some(90.0), &options, &Stop::default(), &Silent).unwrap();
        assert!((given.camera.intrinsics().fx - 80.0).abs() < 1e-9, "{}", given.text());
        let none = find_live_lens(&mut even(0), None, &options, &Stop::default(), &Silent).unwrap_err();
        assert!(none.to_string().contains("/dev/video9: the camera gives no image"), "{none}");
    }
}
