//! The part of the camera's images that the user masked in a drawing.

use super::halved_image;
use crate::pictures::Picture;
use anyhow::{Result, anyhow, bail};
use geometry::{GrayImage, Image, Undistorter};
use std::path::Path;

/// Grey levels below this are black: halfway, so that what a JPEG leaves of a drawn edge is on one side or the other.
const BLACK: u8 = 128;
/// A pixel made of white ones alone is at least this white: undistorting rounds.
const WHITE: u8 = 254;

/// A drawing of the camera's images, black where these are not to be used.
#[derive(Clone, Debug)]
pub struct DrawnMask(GrayImage);

impl DrawnMask {
    /// Reads it from an image file, for a camera whose images have this size.
    ///
    /// # Errors
    /// When the file is no image, or one of another size or without anything to use.
    pub fn read(path: &Path, expected: (usize, usize)) -> Result<Self> {
        let mut mask = Picture::File(path.to_owned()).into_grey().map_err(|why| {
            anyhow!("{why}\nhint: --mask takes a grey image of the camera's size, black where images are not to be used")
        })?;
        let found = (mask.width(), mask.height());
        if found != expected {
            bail!(
                "{}: the mask is {}×{} pixels and the camera's images are {}×{}\nhint: draw it over an image as the camera takes \
                 it, before that is undistorted or halved",
                path.display(),
                found.0,
                found.1,
                expected.0,
                expected.1
            );
        }
        mask.data_mut().iter_mut().for_each(|value| *value = if *value < BLACK { 0 } else { u8::MAX });
        if !mask.data().contains(&u8::MAX) {
            bail!(
                "{}: is black all over and leaves nothing to track\nhint: what is to be used is white",
                path.display()
            );
        }
        Ok(Self(mask))
    }

    /// The masked pixels of undistorted images: those that come from at least one black pixel of the mask, after it
    /// is halved `halvings` times.
    ///
    /// # Errors
    /// When the undistorter is that of another camera.
    pub fn undistorted(&self, halvings: usize, undistorter: &Undistorter) -> Result<Image<bool>> {
        let white = undistorter.undistort(&halved_image(self.0.clone(), halvings))?;
        let unused: Vec<bool> = white.data().iter().map(|value| *value < WHITE).collect();
        Image::from_vec(white.width(), white.height(), unused).ok_or(anyhow!("the mask has no pixels"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{Camera, Crop, Distortion, Pinhole, RadTan};

    fn camera(distortion: Distortion) -> Camera {
        let pinhole = Pinhole { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };
        Camera::new(pinhole, distortion).expect("a camera")
    }

    /// A file of an image of this size that is black left of a column.
    fn drawn(folder: &Path, (width, height): (u32, u32), black: u32) -> std::path::PathBuf {
        let path = folder.join(format!("{width}-{black}.png"));
        let image =
            image::GrayImage::from_fn(width, height, |x, _| image::Luma([if x < black { 60 } else { 200 }]));
        image.save(&path).expect("a file");
        path
    }

    #[test]
    fn what_is_black_is_not_used() {
        let folder = tempfile::tempdir().expect("a folder");
        let mask = DrawnMask::read(&drawn(folder.path(), (64, 48), 20), (64, 48)).expect("a mask");
        let plain = Undistorter::new(&camera(Distortion::None), Crop::default()).expect("a camera");
        let unused = mask.undistorted(0, &plain).expect("its pixels");
        assert!((0..48).all(|y| (0..64).all(|x| unused.get(x, y) == (x < 20))));
        // A barrel shows straight lines bent outwards: undistorted, the mask's edge is that of the images.
        let barrel = camera(Distortion::RadTan(RadTan::new(&[-0.2, 0.0, 0.0, 0.0]).expect("a lens")));
        let undistorter = Undistorter::new(&barrel, Crop::Explicit(*barrel.intrinsics())).expect("a camera");
        let unused = mask.undistorted(0, &undistorter).expect("its pixels");
        for (x, y) in [(0, 0), (5, 40), (18, 23), (22, 2), (40, 23), (63, 47)] {
            let seen = barrel.project(&barrel.intrinsics().unproject(x as f64, y as f64)).expect("a pixel");
            assert_eq!(unused.get(x, y), seen.x < 20.0, "{x} {y} {seen}");
        }
    }

    #[test]
    fn halved_images_have_half_of_the_mask() {
        let folder = tempfile::tempdir().expect("a folder");
        let mask = DrawnMask::read(&drawn(folder.path(), (64, 48), 21), (64, 48)).expect("a mask");
        let half = Camera::new(camera(Distortion::None).intrinsics().at_level(1), Distortion::None)
            .expect("a camera");
        let unused = mask
            .undistorted(1, &Undistorter::new(&half, Crop::default()).expect("a camera"))
            .expect("its pixels");
        // The column that is black by half is not used either.
        assert!((0..24).all(|y| (0..32).all(|x| unused.get(x, y) == (x < 11))));
    }

    #[test]
    fn what_is_no_mask_is_refused_with_the_fix() {
        let folder = tempfile::tempdir().expect("a folder");
        let refusal = |path: &Path| DrawnMask::read(path, (64, 48)).expect_err("no mask").to_string();
        let other = refusal(&drawn(folder.path(), (32, 24), 5));
        assert!(["32×24", "64×48", "hint: draw"].iter().all(|part| other.contains(part)), "{other}");
        assert!(refusal(&drawn(folder.path(), (64, 48), 64)).contains("black all over"));
        assert!(refusal(&folder.path().join("none.png")).contains("none.png"));
        let text = folder.path().join("text.png");
        std::fs::write(&text, "white").expect("a file");
        assert!(refusal(&text).contains("hint: --mask takes a grey image"));
    }
}
