//! Problems of a recording that a sample of its images shows before it is run.

use std::path::Path;

/// Of this many images, evenly over the recording, the size is looked at.
const SAMPLE: usize = 200;

/// The problems of image files, as far as a sample shows them.
pub fn of_images(paths: &[&Path]) -> Vec<String> {
    let mut problems = Vec::new();
    let sample: Vec<&Path> = spread(paths, SAMPLE);
    let sizes: Vec<(&Path, (u32, u32))> =
        sample.iter().filter_map(|path| Some((*path, image::image_dimensions(path).ok()?))).collect();
    if let Some((_, size)) = sizes.first()
        && let Some((path, other)) = sizes.iter().find(|(_, other)| other != size)
    {
        problems.push(format!(
            "images are of several sizes: {}×{} first, {} is {}×{}",
            size.0,
            size.1,
            path.display(),
            other.0,
            other.1
        ));
    }
    problems
}

/// At most `count` of them, evenly.
fn spread<'a>(paths: &[&'a Path], count: usize) -> Vec<&'a Path> {
    paths.iter().step_by(paths.len().div_ceil(count).max(1)).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_that_will_not_do_are_reported() {
        let room = tempfile::tempdir().expect("a folder");
        let path = |name: &str| room.path().join(name);
        let save = |name: &str, image: image::DynamicImage| image.save(path(name)).expect("there is room");
        save("a.png", image::GrayImage::new(8, 6).into());
        save("b.png", image::GrayImage::new(4, 6).into());
        let reported = |names: &[&str]| {
            let paths: Vec<_> = names.iter().map(|name| path(name)).collect();
            of_images(&paths.iter().map(|path| path.as_path()).collect::<Vec<_>>()).join("; ")
        };
        assert_eq!(reported(&["a.png", "a.png"]), "");
        assert!(reported(&["a.png", "b.png"]).contains("several sizes"));
    }
}
