//! The calibration of a run, and what it does to each image.

mod mask;

pub use mask::DrawnMask;

use crate::pictures::ColorPicture;
use crate::recording::CalibrationFiles;
use crate::{FoundCalibration, SourceInfo};
use anyhow::{Context, Result, bail};
use calib::read_camera_of;
use geometry::{
    Camera, Crop, Distortion, GrayImage, Image, ImageSizeError, PhotometricCalibration, Pinhole, Undistorter,
    halved,
};
use map::Color;
use slam_direct::LazyColor;
use std::path::PathBuf;
use std::sync::Arc;

/// Views wider than this, degrees, need a fisheye model: rectilinear lenses end near 120°.
pub const WIDEST_VIEW: f64 = 130.0;
/// Views narrower than this, degrees, are those of telephoto lenses (above 200 mm on 35 mm film).
pub const NARROWEST_VIEW: f64 = 10.0;
/// Default of `max_width`: KITTI's images are the widest that are common in benchmarks.
pub const DEFAULT_MAX_WIDTH: usize = 1280;

/// The user's options about the camera.
#[derive(Clone, Debug)]
pub struct CameraOptions {
    /// Calibration file, instead of the one that came with the recording.
    pub calibration: Option<PathBuf>,
    /// Whether to ignore a calibration that came with the recording.
    pub leave_found: bool,
    /// Inverse response of the sensor.
    pub response: Option<PathBuf>,
    /// Vignette of the lens.
    pub vignette: Option<PathBuf>,
    /// A grey image of the camera's size, black where its images are not to be used: a bonnet, a gripper.
    pub mask: Option<PathBuf>,
    /// The size of the images, to which the calibration is to be scaled.
    pub scale_to: Option<(usize, usize)>,
    /// Images wider than this are halved until they are not. A direct method gains nothing from more pixels than its
    /// lens and its motion resolve, and takes four times as long.
    pub max_width: usize,
}

impl Default for CameraOptions {
    fn default() -> Self {
        Self {
            calibration: None,
            leave_found: false,
            response: None,
            vignette: None,
            mask: None,
            scale_to: None,
            max_width: DEFAULT_MAX_WIDTH,
        }
    }
}

impl CameraOptions {
    /// The mask for images of this size, if the user gave one.
    ///
    /// # Errors
    /// Those of [`DrawnMask::read`].
    pub fn drawn_mask(&self, size: (usize, usize)) -> Result<Option<DrawnMask>> {
        self.mask.as_deref().map(|path| DrawnMask::read(path, size)).transpose()
    }
}

/// How often an image is halved so that it is no wider than `max_width`.
pub fn halvings(width: usize, max_width: usize) -> usize {
    (0..usize::BITS as usize - 1).find(|&times| width >> times <= max_width).unwrap_or(0)
}

/// The camera of images that are halved `times` times.
///
/// # Errors
/// When nothing is left of the image.
pub fn halved_camera(camera: &Camera, times: usize) -> Result<Camera> {
    Ok(Camera::new(camera.intrinsics().at_level(times), *camera.distortion())?)
}

/// The camera of images of which these are the halves.
///
/// # Errors
/// When that is no camera.
pub fn doubled_camera(camera: &Camera, size: (usize, usize), times: usize) -> Result<Camera> {
    enlarged(camera, size, (1u64 << times) as f64)
}

/// An image halved `times` times.
pub fn halved_image(image: GrayImage, times: usize) -> GrayImage {
    (0..times).fold(image, |image, _| halved(&image))
}

/// The corrections of an image before tracking.
pub struct ImageCorrection {
    photometric: Option<PhotometricCalibration>,
    undistorter: Undistorter,
    /// The camera as calibrated.
    calibrated: Camera,
    /// How often images are halved.
    halvings: usize,
    /// The camera of the halved images.
    lens: Camera,
    /// Where the calibration came from, for people.
    origin: String,
    /// What of the camera's images is not to be used.
    drawn_mask: Option<DrawnMask>,
    /// Pixels of the corrected images that are not to be used.
    unused: Option<Image<bool>>,
}

impl ImageCorrection {
    /// The camera of the corrected images.
    pub fn camera(&self) -> Pinhole {
        *self.undistorter.pinhole()
    }

    /// The lens of the images that are undistorted: as calibrated, or for images that are halved.
    pub fn lens(&self) -> &Camera {
        &self.lens
    }

    /// How often images are halved before all else.
    pub fn halvings(&self) -> usize {
        self.halvings
    }

    /// Where the calibration came from, for people.
    pub fn origin(&self) -> &str {
        &self.origin
    }

    /// The camera as calibrated, before images are halved.
    pub fn calibrated(&self) -> &Camera {
        &self.calibrated
    }

    /// The calibration and where it came from, for people.
    pub fn text(&self) -> String {
        format!("{}: {}", self.origin, described(&self.calibrated))
    }

    /// The mask of the camera's images before they are halved, if the user gave one.
    pub fn drawn_mask(&self) -> Option<&DrawnMask> {
        self.drawn_mask.as_ref()
    }

    /// The pixels of the corrected images that are masked, if the user gave a mask.
    pub fn unused(&self) -> Option<&Image<bool>> {
        self.unused.as_ref()
    }

    /// A warning about the calibration: a field of view that lenses of its model do not have.
    pub fn problem(&self) -> Option<String> {
        let &Pinhole { width, fx, .. } = self.calibrated.intrinsics();
        let plane = matches!(self.calibrated.distortion(), Distortion::None | Distortion::RadTan(_));
        let degrees = 2.0 * (width as f64 / (2.0 * fx)).atan().to_degrees();
        let odd = |what| {
            format!(
                "the calibration's view is {degrees:.0}° wide, which is {what}: is fx = {fx} right for images {width} pixels wide?"
            )
        };
        match degrees {
            _ if !plane => None,
            WIDEST_VIEW.. => Some(odd("more than lenses without a fisheye model have")),
            ..NARROWEST_VIEW => Some(odd("less than any but tele lenses have")),
            _ => None,
        }
    }

    /// Corrects an image; the error says why it does not fit.
    pub fn apply(&self, mut image: GrayImage) -> Result<GrayImage, String> {
        if let Some(photometric) = &self.photometric {
            photometric.apply_in_place(&mut image).map_err(|error| error.to_string())?;
        }
        let found = (image.width(), image.height());
        let &Pinhole { width, height, .. } = self.calibrated.intrinsics();
        if found != (width, height) {
            let error = ImageSizeError { found, expected: (width, height) };
            let scaled = is_scaled(&self.calibrated, found);
            let hint = if scaled { "\nhint: --scale-calib scales it to these images" } else { "" };
            return Err(format!("{error}{hint}"));
        }
        self.undistorter.undistort(&halved_image(image, self.halvings)).map_err(|error| error.to_string())
    }
}

impl ImageCorrection {
    /// A decoded picture as a frame has it: the corrected grey image, and its colours, which are decoded and corrected when
    /// they are asked for; the error says why it does not fit.
    pub fn frame(
        self: &Arc<Self>,
        (image, color): (GrayImage, Option<ColorPicture>),
    ) -> Result<(GrayImage, Option<LazyColor>), String> {
        let image = self.apply(image)?;
        let correction = Arc::clone(self);
        let color = color.map(|color| LazyColor::new(move || correction.color(&color)));
        Ok((image, color))
    }

    /// The colours of a picture, corrected as its grey levels are; only response and vignette are left in them. `None` where
    /// it has none, or does not fit.
    pub fn color(&self, picture: &ColorPicture) -> Option<Color> {
        let (luma, planes) = picture.planes()?;
        let placed = |plane| self.undistorter.undistort(&halved_image(plane, self.halvings)).ok();
        let [blue, red] = planes.map(placed);
        Color::of_planes(luma, [&blue?, &red?])
    }
}

/// The correction for a recording: from the user's calibration if there is one, else from what came with it.
///
/// # Errors
/// When there is no calibration, or it cannot be used.
pub fn correction(options: &CameraOptions, info: &SourceInfo) -> Result<ImageCorrection> {
    let (camera, crop, origin) = match (&options.calibration, &info.calibration) {
        (Some(path), _) | (None, Some(FoundCalibration::File(path))) => {
            let file = read_camera_of(path, &info.camera)?;
            (file.camera, file.crop.unwrap_or_default(), path.display().to_string())
        }
        (
            None,
            Some(FoundCalibration::Inside { origin, camera } | FoundCalibration::Preset { origin, camera }),
        ) => (Camera::clone(camera), Crop::default(), origin.clone()),
        (None, Some(FoundCalibration::Recorded { origin, files })) if files.camera.is_some() => {
            let Some(file) = files.camera().with_context(|| origin.clone())? else {
                bail!("{origin}: no camera")
            };
            (file.camera, file.crop.unwrap_or_default(), origin.clone())
        }
        (None, Some(FoundCalibration::Unusable { origin, reason })) => {
            bail!(
                "{origin}: the calibration cannot be used: {reason}\nhint: give one with --calib FILE, or have the lens \
                 found from the images with --calib none"
            )
        }
        (None, None | Some(FoundCalibration::Recorded { .. } | FoundCalibration::Uncalibrated { .. })) => {
            bail!(
                "{}: no calibration came with this recording\nhint: give one with --calib FILE (a camera.yaml with \
             model, width, height, fx, fy, cx, cy, distortion; Kalibr, ROS, OpenCV and DSO files do too)",
                info.path.display()
            )
        }
    };
    let camera = match options.scale_to {
        Some(size) => scaled(&camera, size).with_context(|| origin.clone())?,
        None => camera,
    };
    let times = halvings(camera.intrinsics().width, options.max_width);
    let lens = halved_camera(&camera, times).with_context(|| origin.clone())?;
    let crop = match crop {
        Crop::Explicit(pinhole) => Crop::Explicit(pinhole.at_level(times)),
        other => other,
    };
    let undistorter = Undistorter::new(&lens, crop).with_context(|| origin.clone())?;
    let drawn_mask = options.drawn_mask((camera.intrinsics().width, camera.intrinsics().height))?;
    let unused = drawn_mask.as_ref().map(|mask| mask.undistorted(times, &undistorter)).transpose()?;
    Ok(ImageCorrection {
        photometric: CalibrationFiles::gather_photometric(options, info)?.photometric()?,
        undistorter,
        drawn_mask,
        unused,
        calibrated: camera,
        halvings: times,
        lens,
        origin,
    })
}

/// A camera for people: model, size, focal length and the view that makes.
pub fn described(camera: &Camera) -> String {
    let &Pinhole { width, height, fx, .. } = camera.intrinsics();
    let lens = match camera.distortion() {
        Distortion::None => "pinhole",
        Distortion::RadTan(_) => "radial-tangential",
        Distortion::KannalaBrandt(_) => "Kannala-Brandt",
        Distortion::Fov(_) => "field-of-view",
    };
    let view = 2.0 * (width as f64 / (2.0 * fx)).atan().to_degrees();
    // Behind a lens that bends, what the focal length alone would show is not what it shows.
    let view =
        if camera.distortion().is_identity() { format!(" (view of {view:.0}°)") } else { String::new() };
    format!("{lens} {width}×{height}, fx {fx:.1} px{view}")
}

/// Whether images of this size are those of the camera, larger or smaller.
fn is_scaled(camera: &Camera, (width, height): (usize, usize)) -> bool {
    let own = camera.intrinsics();
    width.checked_mul(own.height).is_some_and(|product| Some(product) == height.checked_mul(own.width))
}

/// The camera for images of another size that show the same: numbers in pixels are scaled, the lens stays as it is.
fn scaled(camera: &Camera, (width, height): (usize, usize)) -> Result<Camera> {
    let own = camera.intrinsics().width;
    if !is_scaled(camera, (width, height)) {
        bail!(
            "images of {width}×{height} pixels are not those of the calibration, {own}×{}, made larger or smaller\nhint: \
             --scale-calib is for those; this may be another camera, or a part of the image",
            camera.intrinsics().height
        );
    }
    enlarged(camera, (width, height), width as f64 / own as f64)
}

/// The camera of images `by` times as large, of this size.
fn enlarged(camera: &Camera, (width, height): (usize, usize), by: f64) -> Result<Camera> {
    let &Pinhole { fx, fy, cx, cy, .. } = camera.intrinsics();
    // Pixel centres lie at integers, so the image begins half a pixel before the first.
    let centre = |c: f64| (c + 0.5) * by - 0.5;
    let pinhole = Pinhole { width, height, fx: fx * by, fy: fy * by, cx: centre(cx), cy: centre(cy) };
    Ok(Camera::new(pinhole, *camera.distortion())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_images_are_halved_until_they_are_not() {
        assert_eq!(
            [640, 1280, 1281, 1920, 2560, 3840].map(|width| halvings(width, 1280)),
            [0, 0, 1, 1, 1, 2]
        );
        let pinhole = Pinhole { width: 1920, height: 1080, fx: 1400.0, fy: 1410.0, cx: 960.5, cy: 539.5 };
        let camera = Camera::new(pinhole, Distortion::None).expect("a camera");
        let half = halved_camera(&camera, 1).expect("half of it");
        let expected = Pinhole { width: 960, height: 540, fx: 700.0, fy: 705.0, cx: 480.0, cy: 269.5 };
        assert_eq!(*half.intrinsics(), expected);
        assert_eq!(doubled_camera(&half, (1920, 1080), 1).expect("twice that"), camera);
        assert_eq!(halved_image(GrayImage::filled(1920, 1080, 7), 1), GrayImage::filled(960, 540, 7));
    }

    /// Where the lens bends and images are halved, colours lie where the grey levels do.
    #[test]
    fn colours_are_corrected_as_the_image_is() {
        use crate::pictures::{Picture, RawPicture};
        use geometry::RadTan;
        let (width, height) = (640, 480);
        let pinhole = Pinhole { width, height, fx: 400.0, fy: 400.0, cx: 320.0, cy: 240.0 };
        let lens = Distortion::RadTan(RadTan::new(&[-0.25, 0.05, 0.0, 0.0]).expect("a lens"));
        let camera = Box::new(Camera::new(pinhole, lens).expect("a camera"));
        let calibration = Some(FoundCalibration::Inside { origin: "a test".into(), camera });
        let info = SourceInfo { calibration, ..SourceInfo::new("a picture", "a test") };
        let options = CameraOptions { max_width: 320, ..CameraOptions::default() };
        let correction = Arc::new(correction(&options, &info).expect("a correction"));
        // Stripes of two colours, which the lens bends.
        let color =
            |i: usize| if ((i % width) / 80).is_multiple_of(2) { [210, 60, 50] } else { [40, 80, 220] };
        let channel = |c: usize| {
            let data = (0..width * height).map(|i| color(i)[c]).collect();
            correction.apply(GrayImage::from_vec(width, height, data).expect("a channel")).expect("it fits")
        };
        let expected = [0, 1, 2].map(channel);
        let data = (0..width * height).flat_map(color).collect();
        let (step, encoding) = (3 * width, "rgb8".to_owned());
        let picture = Picture::Raw(RawPicture { width, height, step, encoding, big_endian: false, data });
        let (image, lazy) =
            correction.frame(picture.into_grey_and_color().expect("it decodes")).expect("it fits");
        let size = (image.width(), image.height());
        let colors =
            lazy.and_then(|lazy| lazy.get()).expect("it has colours").decoded(size).expect("its size");
        let is_far = |i: &usize| {
            let found = colors.at(i % size.0, i / size.0, image.data()[*i]);
            (0..3).any(|c| found[c].abs_diff(expected[c].data()[*i]) > 40)
        };
        // Beside the edges of the stripes colours are those of two pixels.
        let far = (0..size.0 * size.1).filter(is_far).count();
        assert!(far * 50 < size.0 * size.1, "{far} of {} pixels", size.0 * size.1);
    }

    #[test]
    fn a_calibration_is_scaled_with_its_images() {
        let pinhole = Pinhole { width: 640, height: 480, fx: 500.0, fy: 510.0, cx: 319.5, cy: 240.0 };
        let camera = Camera::new(pinhole, Distortion::None).expect("a camera");
        let twice = scaled(&camera, (1280, 960)).expect("twice the size");
        let expected = Pinhole { width: 1280, height: 960, fx: 1000.0, fy: 1020.0, cx: 639.5, cy: 480.5 };
        assert_eq!(*twice.intrinsics(), expected);
        assert_eq!(*scaled(&twice, (640, 480)).expect("half of it").intrinsics(), pinhole);
        assert!(scaled(&camera, (1280, 720)).is_err_and(|error| error.to_string().contains("1280×720")));
    }
}
