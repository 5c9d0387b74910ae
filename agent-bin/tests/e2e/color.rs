//! Colours, from a recording's images to the files of other tools: they change nothing that is computed.

use crate::support::{Case, Outcome, drive, loopbox};
use image::{Rgb, RgbImage};
use loopbox_tests::{Encoding, Recording};
use map::{Keyframe, Map};
use std::fs;
use std::path::Path;

/// How far the compression of colours may bring a level off.
const COMPRESSION: u8 = 12;

/// A colour of about this grey level: reddish on the left of an image, bluish on the right.
fn colored(grey: u8, is_left: bool) -> [u8; 3] {
    let (more_red, more_blue) = if is_left { (50, -30) } else { (-40, 60) };
    let level = |more: i32| (i32::from(grey) + more).clamp(0, 255);
    let (red, blue) = (level(more_red), level(more_blue));
    let green = (10_000 * i32::from(grey) + 5_000 - 2126 * red - 722 * blue).div_euclid(7152);
    let is_grey = |green: &i32| (2126 * red + 7152 * green + 722 * blue) / 10_000 == i32::from(grey);
    match (green - 1..=green + 1).filter(|green| (0..=255).contains(green)).find(is_grey) {
        Some(green) => [red, green, blue].map(|level| level as u8),
        None => [grey; 3],
    }
}

/// Writes a recording whose images are in colour and have about the grey levels of its own.
fn write_colored(recording: &Recording, folder: &Path) {
    recording.write(folder, Encoding::Png).expect("the temporary folder takes the recording");
    for (i, shot) in recording.shots.iter().enumerate() {
        let (width, height) = (shot.image.width() as u32, shot.image.height() as u32);
        let pixel = |x: u32, y: u32| Rgb(colored(shot.image.get(x as usize, y as usize), 2 * x < width));
        let image = RgbImage::from_fn(width, height, pixel);
        image.save(folder.join(format!("images/{i:06}.png"))).expect("the image is written");
    }
}

/// The recording that a folder in colour is as it is read: in grey.
fn in_grey(mut recording: Recording, folder: &Path) -> Recording {
    for (i, shot) in recording.shots.iter_mut().enumerate() {
        let picture = sources::pictures::Picture::File(folder.join(format!("images/{i:06}.png")));
        shot.image = std::sync::Arc::new(picture.into_grey().expect("it was written"));
    }
    recording
}

fn part(frames: std::ops::Range<usize>) -> Recording {
    let recording = drive();
    Recording { shots: recording.shots[frames].to_vec(), ..recording }
}

/// Whether a colour of the map is that of the source at a pixel whose grey level it has.
fn is_near(found: [u8; 3], grey: u8, x: usize, width: usize) -> bool {
    // Colours at half the resolution are smooth across the edge between them.
    (2 * x).abs_diff(width) <= 6
        || found.iter().zip(colored(grey, 2 * x < width)).all(|(a, b)| a.abs_diff(b) <= COMPRESSION)
}

/// Fails unless the pixels have the source's colours, but for a few: beside pixels that are too bright or dark for theirs.
fn assert_near(keyframe: &Keyframe, colors: &[[u8; 3]], pixels: impl Iterator<Item = usize>) {
    let width = keyframe.image.width();
    let is_far = |(color, pixel): &(&[u8; 3], usize)| {
        !is_near(**color, keyframe.image.data()[*pixel], pixel % width, width)
    };
    let far: Vec<_> = colors.iter().zip(pixels).filter(is_far).collect();
    let most = colors.len() / 20;
    assert!(far.len() <= most, "keyframe {}: {} of {}", keyframe.id.0, far.len(), colors.len());
}

/// Red, green and blue of the points of a run's `cloud.ply`.
fn cloud_colors(path: &Path) -> Vec<[u8; 3]> {
    let bytes = fs::read(path).expect("the cloud is there");
    let end = b"end_header\n";
    let begin = bytes.windows(end.len()).position(|part| part == end).expect("a header") + end.len();
    bytes[begin..].chunks_exact(20).map(|point| [point[17], point[18], point[19]]).collect()
}

fn without_colors(map: &Map) -> Vec<Keyframe> {
    map.keyframes.values().map(|keyframe| Keyframe { color: None, ..keyframe.clone() }).collect()
}

#[test]
fn colours_change_nothing_but_colours_and_reach_every_file() {
    let color = Case::empty();
    write_colored(&part(0..45), &color.source());
    let grey = Case::new(&in_grey(part(0..45), &color.source()));
    grey.run(&[]).assert_success();
    color.run(&[]).assert_success();
    for file in ["trajectory.txt", "trajectory-live.txt"] {
        let read = |case: &Case| fs::read(case.out().join(file)).expect("it was written");
        assert!(read(&grey) == read(&color), "{file}");
    }
    let (in_grey, in_color) = (grey.map(), color.map());
    assert!(in_grey.keyframes.values().eq(without_colors(&in_color).iter()));
    assert!((&in_grey.edges, &in_grey.frames) == (&in_color.edges, &in_color.frames));
    assert!(in_color.keyframes.values().all(|keyframe| keyframe.color.is_some()));

    // Every point has the colour of its pixel.
    let colors = cloud_colors(&color.out().join("cloud.ply"));
    let bound = map::DEFAULT_MAX_RELATIVE_VARIANCE;
    let mut rest = &colors[..];
    for keyframe in in_color.keyframes.values() {
        let certain = keyframe.semi_dense.iter().filter(|(_, d, v)| v / (d * d) <= bound);
        let pixels: Vec<usize> = certain.map(|(pixel, ..)| pixel as usize).collect();
        let (own, behind) = rest.split_at(pixels.len());
        assert_near(keyframe, own, pixels.into_iter());
        rest = behind;
    }
    assert!(rest.is_empty() && colors.len() > 10_000);
    assert!(colors.iter().filter(|[red, _, blue]| red.abs_diff(*blue) > 30).count() > colors.len() / 2);
    let greys = cloud_colors(&grey.out().join("cloud.ply"));
    assert!(greys.iter().all(|[red, green, blue]| red == green && green == blue));

    // And so have the images for other tools.
    let folder = color.source().with_file_name("colmap");
    let mut export = loopbox();
    export.arg("export").arg(color.out()).arg("--colmap").arg(&folder);
    Outcome::of(export).assert_success();
    for keyframe in in_color.keyframes.values() {
        let name = format!("images/recording-{:06}.png", keyframe.frame_index);
        let image = image::open(folder.join(&name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let pixels: Vec<[u8; 3]> =
            image.as_rgb8().expect("in colour").pixels().map(|pixel| pixel.0).collect();
        assert_near(keyframe, &pixels, 0..pixels.len());
    }
    let page = fs::read_to_string(color.out().join("report.html")).expect("the report is there");
    assert!(page.contains("\"color\":\""));
    let page = fs::read_to_string(grey.out().join("report.html")).expect("the report is there");
    assert!(!page.contains("\"color\":\""));
}

#[test]
fn a_map_that_is_extended_keeps_its_colours() {
    let case = Case::empty();
    let (first, second, grey) = (part(0..45), part(45..70), part(45..70));
    let folder = |name: &str| case.source().with_file_name(name);
    write_colored(&first, &case.source());
    write_colored(&second, &folder("second"));
    grey.write(&folder("grey"), Encoding::Png).expect("the temporary folder takes the recording");
    case.run(&[]).assert_success();
    let count = case.map().keyframes.len();
    for (source, has_color) in [("second", true), ("grey", false)] {
        let out = folder(&format!("out of {source}"));
        let mut go_on = loopbox();
        go_on.arg("run").arg(folder(source)).arg("--continue").arg(case.out()).arg("--out").arg(&out);
        Outcome::of(go_on).assert_success();
        let map = map::load_map(out.join("map.mcap")).expect("the map loads").map;
        assert!(map.keyframes.len() > count);
        for (i, keyframe) in map.keyframes.values().enumerate() {
            assert_eq!(keyframe.color.is_some(), i < count || has_color, "keyframe {i} with {source}");
        }
    }
}
