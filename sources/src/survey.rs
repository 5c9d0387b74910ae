//! What can be seen to be wrong with a recording before it is run: its times, and a sample of its images.

use std::path::Path;

/// Of this many images, evenly over the recording, the size is looked at; of some of them the grey levels.
const SAMPLE: usize = 200;
const DEEP_SAMPLE: usize = 5;
/// Times in seconds since 1970 end well before this, in the year 2603; in milliseconds and finer they begin beyond.
const LATEST_S: f64 = 2e10;
/// No recording lasts as long as a year between two of its frames; nanoseconds that count from 0 do.
const LONGEST_STEP_S: f64 = 3e7;
/// Of 16 bits, images of 12 use only these values.
const TWELVE_BITS: u16 = 1 << 12;

/// What is wrong with the times of frames, in seconds.
pub fn of_times(times: &[f64]) -> Vec<String> {
    let mut problems = Vec::new();
    let steps = || times.windows(2).map(|pair| pair[1] - pair[0]);
    if let Some(late) = times.iter().find(|t| t.abs() > LATEST_S) {
        problems.push(format!("the time stamp {late} is no time in seconds: is it in nanoseconds?"));
    } else if let Some(step) = steps().find(|step| step.abs() > LONGEST_STEP_S) {
        problems.push(format!("time stamps are {step} s apart: are they in nanoseconds?"));
    }
    let (backward, repeated) =
        (steps().filter(|step| *step < 0.0).count(), steps().filter(|s| *s == 0.0).count());
    if backward > 0 {
        let text = if backward + 1 == times.len() {
            "all run backwards".to_owned()
        } else {
            format!("run backwards {backward} times")
        };
        problems.push(format!("the time stamps {text}: such frames are skipped"));
    }
    if repeated > 0 {
        problems.push(format!("{repeated} time stamps repeat the one before: such frames are skipped"));
    }
    problems
}

/// What is wrong with image files, as far as a sample shows it.
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
    if let Some(brightest) = brightest_of_16_bits(&spread(paths, DEEP_SAMPLE))
        && brightest < TWELVE_BITS
    {
        problems.push(format!(
            "images have 16 bits and use at most {} levels of 65536, as cameras of 12 bits or fewer write them: they look \
             black here; multiply their values by {}",
            u32::from(brightest) + 1,
            65536 / (u32::from(brightest) + 1).next_power_of_two()
        ));
    }
    problems
}

/// The largest value in images of 16 bits; nothing where one of them is no such image.
fn brightest_of_16_bits(paths: &[&Path]) -> Option<u16> {
    let largest = |path: &&Path| match image::open(path).ok()? {
        image::DynamicImage::ImageLuma16(deep) => deep.pixels().map(|pixel| pixel.0[0]).max(),
        _ => None,
    };
    paths.iter().map(largest).collect::<Option<Vec<u16>>>()?.into_iter().max()
}

/// At most `count` of them, evenly.
fn spread<'a>(paths: &[&'a Path], count: usize) -> Vec<&'a Path> {
    paths.iter().step_by(paths.len().div_ceil(count).max(1)).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_that_are_none_are_told() {
        let told = |times: &[f64]| of_times(times).join("; ");
        assert_eq!(told(&[0.0, 0.1, 0.2]), "");
        assert_eq!(told(&[1.4e9, 1.4e9 + 0.1]), "");
        assert!(told(&[1.4e18, 1.4e18 + 5e7]).contains("nanoseconds"));
        assert!(told(&[0.0, 6.6e7, 1.3e8]).contains("nanoseconds"));
        assert!(told(&[0.3, 0.2, 0.1]).contains("all run backwards"));
        assert!(told(&[0.0, 0.2, 0.1, 0.1]).contains("backwards 1 times"));
        assert!(told(&[0.0, 0.2, 0.2]).contains("repeat"));
    }

    #[test]
    fn images_that_will_not_do_are_told() {
        let room = tempfile::tempdir().expect("a folder");
        let path = |name: &str| room.path().join(name);
        let save = |name: &str, image: image::DynamicImage| image.save(path(name)).expect("there is room");
        save("a.png", image::GrayImage::new(8, 6).into());
        save("b.png", image::GrayImage::new(4, 6).into());
        let deep = |top: u16| {
            let level = move |x, _| image::Luma([if x == 0 { top } else { 7 }]);
            image::DynamicImage::from(image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::from_fn(8, 6, level))
        };
        save("c.png", deep(4095));
        save("d.png", deep(40_000));
        let told = |names: &[&str]| {
            let paths: Vec<_> = names.iter().map(|name| path(name)).collect();
            of_images(&paths.iter().map(|path| path.as_path()).collect::<Vec<_>>()).join("; ")
        };
        assert_eq!(told(&["a.png", "a.png"]), "");
        assert!(told(&["a.png", "b.png"]).contains("several sizes"));
        assert!(told(&["c.png", "c.png"]).contains("multiply their values by 16"));
        assert_eq!(told(&["c.png", "d.png"]), "");
    }
}
