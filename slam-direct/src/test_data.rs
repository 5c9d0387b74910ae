//! Keyframes with ground-truth depth from rendered sequences, for measurements that are run by hand.

use geometry::{GrayImage, Pinhole, Pyramid, Se3};
use map::SemiDense;
use std::path::{Path, PathBuf};

/// The folder of sequences.
pub(crate) fn data() -> PathBuf {
    std::env::var_os("LOOPBOX_DATA").expect("set LOOPBOX_DATA to the folder of sequences").into()
}

/// The camera of the `parking_*` sequences.
pub(crate) fn camera() -> Pinhole {
    Pinhole { width: 640, height: 480, fx: 420.0, fy: 420.0, cx: 319.5, cy: 239.5 }
}

/// `world_from_camera` of every frame.
pub(crate) fn poses(sequence: &Path) -> Vec<Se3> {
    let text = std::fs::read_to_string(sequence.join("groundtruth.txt")).unwrap();
    let number = |v: &str| v.parse::<f64>().unwrap();
    text.lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| line.split_whitespace().skip(1).map(number).collect::<Vec<_>>())
        .map(|values| Se3::from_tum(values.try_into().unwrap()))
        .collect()
}

/// Frame `index` with depth at high gradients, `scale` metres per keyframe unit, and depth noise of
/// `sigma` relative, deterministic.
pub(crate) fn keyframe(sequence: &Path, index: usize, scale: f64, sigma: f32) -> (Pyramid, SemiDense) {
    let name = |folder: &str, ending: &str| sequence.join(folder).join(format!("{index:06}.{ending}"));
    let open = |path: PathBuf| image::open(path).unwrap();
    let gray = open(name("images", "jpg")).into_luma8();
    let depth = open(name("depth", "png")).into_luma16();
    let (width, height) = (gray.width() as usize, gray.height() as usize);
    let image = GrayImage::from_vec(width, height, gray.into_raw()).unwrap();
    let mut semi_dense = SemiDense::default();
    let mut random = geometry::Random::new(index as u64);
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let gx = image.get(x + 1, y) as f32 - image.get(x - 1, y) as f32;
            let gy = image.get(x, y + 1) as f32 - image.get(x, y - 1) as f32;
            let millimetres = depth.get_pixel(x as u32, y as u32).0[0];
            if gx.hypot(gy) < 16.0 || millimetres == 0 {
                continue;
            }
            let noise = random.normal() as f32;
            let inverse_depth = (scale * 1000.0 / millimetres as f64) as f32;
            semi_dense.pixel.push((y * width + x) as u32);
            semi_dense.inverse_depth.push(inverse_depth * (1.0 + sigma * noise).max(0.1));
            semi_dense.variance.push((sigma.max(0.01) * inverse_depth).powi(2));
        }
    }
    (Pyramid::new(image, 6), semi_dense)
}

/// The image of a frame.
pub(crate) fn image(sequence: &Path, index: usize) -> GrayImage {
    let gray = image::open(sequence.join(format!("images/{index:06}.jpg"))).unwrap().into_luma8();
    GrayImage::from_vec(gray.width() as usize, gray.height() as usize, gray.into_raw()).unwrap()
}
