//! Colours on their way through files, merges and exports.

use crate::test_support::{color_at, in_color, lidar_map, sample_map, united};
use crate::*;
use std::fs;
use std::path::Path;

/// How far the compression may bring a level off.
const COMPRESSION: u8 = 8;

fn is_near(found: [u8; 3], expected: [u8; 3]) -> bool {
    found.iter().zip(expected).all(|(found, expected)| found.abs_diff(expected) <= COMPRESSION)
}

fn painted(keyframes: u32) -> Map {
    let mut map = sample_map(keyframes);
    in_color(&mut map, |_| true);
    map
}

/// Two agents with colours and one without.
fn mixed() -> Map {
    let mut map = united();
    in_color(&mut map, |agent| agent != AgentId(1));
    map
}

fn contains(file: &Path, word: &str) -> bool {
    fs::read(file).unwrap().windows(word.len()).any(|part| part == word.as_bytes())
}

#[test]
fn colours_come_back_from_a_file_as_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    for map in [painted(3), mixed()] {
        save_map(&first, &map).unwrap();
        let loaded = load_map(&first).unwrap();
        assert!(loaded.complete && loaded.map == map);
        save_map(&second, &loaded.map).unwrap();
        assert_eq!(fs::read(&first).unwrap(), fs::read(&second).unwrap());
        assert!(contains(&first, "/loopbox/color"));
    }
}

#[test]
fn the_file_of_a_map_without_colours_does_not_know_of_any() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.mcap");
    for map in [sample_map(3), united(), lidar_map(1)] {
        save_map(&path, &map).unwrap();
        assert!(!contains(&path, "/loopbox/color") && !contains(&path, "loopbox.Color"));
    }
}

#[test]
fn a_growing_file_has_the_colours_of_its_keyframes() {
    let (folder, map) = (tempfile::tempdir().unwrap(), painted(3));
    let path = folder.path().join("map.mcap");
    let mut writer = MapWriter::create(&path, &map.agents[&AgentId::default()]).unwrap();
    writer.append(&MapDelta::whole(&map), &map.frames).unwrap();
    writer.flush().unwrap();
    drop(writer);
    let loaded = load_map(&path).unwrap().map;
    assert!(loaded.keyframes == map.keyframes);
}

#[test]
fn agents_keep_their_colours_in_a_common_map_and_apart_again() {
    let (one, other) = (painted(3), lidar_map(1));
    let grey = united().split().remove(1);
    let common = Map::unite(vec![one.clone(), grey.clone(), other.clone()]).unwrap();
    assert_eq!(common.keyframes.values().filter(|keyframe| keyframe.color.is_some()).count(), 3);
    assert!(common.split() == [one, grey, other]);
}

#[test]
fn the_colours_of_a_keyframe_are_a_part_of_their_own() {
    let map = painted(1);
    let keyframe = map.keyframes.values().next().unwrap();
    let bytes = parts::color_to_bytes(keyframe.id, keyframe.color.as_ref().unwrap());
    assert_eq!(parts::color_from_bytes(&bytes), Ok((keyframe.id, keyframe.color.clone())));
    for end in 0..bytes.len() {
        let _ = parts::color_from_bytes(&bytes[..end]).map(|(_, color)| color.map(|c| c.decoded((24, 18))));
    }
}

#[test]
fn points_have_the_colours_of_their_pixels_and_those_of_a_grey_source_are_grey() {
    for map in [painted(2), mixed()] {
        let mut cloud = map.cloud(f32::INFINITY);
        for keyframe in map.keyframes.values() {
            let (width, own) = (keyframe.image.width(), keyframe.id);
            for pixel in keyframe.semi_dense.pixel.iter() {
                let point = cloud.next().unwrap();
                let (x, y) = (*pixel as usize % width, *pixel as usize / width);

                match point.color {
                    Some(color) => assert!(is_near(color, color_at(own, x, y)), "{color:?} at {x} {y}"),
                    None => assert_eq!(point.agent, AgentId(1)),
                }
            }
        }
    }
}

/// Red, green and blue of each point of a PLY file with so many bytes a point, of which they begin at the 17th.
fn colors_in_ply(map: &Map, stride: usize) -> Vec<[u8; 3]> {
    let mut bytes = Vec::new();
    write_ply(&mut bytes, map, f32::INFINITY).unwrap();
    let end = b"end_header\n";
    let begin = bytes.windows(end.len()).position(|part| part == end).unwrap() + end.len();
    bytes[begin..].chunks_exact(stride).map(|point| [point[17], point[18], point[19]]).collect()
}

#[test]
fn clouds_are_in_colour_where_the_source_was() {
    let map = painted(2);
    let cloud: Vec<CloudPoint> = map.cloud(f32::INFINITY).collect();
    let expected: Vec<[u8; 3]> = cloud.iter().map(|point| point.color.unwrap()).collect();
    assert_eq!(colors_in_ply(&map, 20), expected);
    assert!(expected.iter().any(|[red, green, _]| red.abs_diff(*green) > 40));
    // Among agents of which some have colours, those without are grey.
    let map = mixed();
    let cloud: Vec<CloudPoint> = map.cloud(f32::INFINITY).collect();
    let color = |point: &CloudPoint| point.color.unwrap_or([point.intensity; 3]);
    assert_eq!(colors_in_ply(&map, 22), cloud.iter().map(color).collect::<Vec<_>>());
    assert!(cloud.iter().any(|point| point.color.is_none()));
}

/// The pixels of a PNG file in colour; `None` of a grey one.
fn pixels_of(path: &Path) -> Option<Vec<[u8; 3]>> {
    let image = image::load_from_memory(&fs::read(path).unwrap()).unwrap();
    let image::DynamicImage::ImageRgb8(pixels) = image else { return None };
    Some(pixels.pixels().map(|pixel| pixel.0).collect())
}

#[test]
fn posed_images_are_in_colour_and_so_are_their_points() {
    let folder = tempfile::tempdir().unwrap();
    let map = mixed();
    save_colmap(folder.path().join("colmap"), &map).unwrap();
    save_nerfstudio(folder.path().join("nerfstudio"), &map).unwrap();
    let labels = map.agent_labels();
    for keyframe in map.keyframes.values() {
        let name = format!("images/{}-{:06}.png", labels[&keyframe.agent], keyframe.frame_index);
        for tool in ["colmap", "nerfstudio"] {
            let pixels = pixels_of(&folder.path().join(tool).join(&name));
            assert_eq!(pixels.is_some(), keyframe.color.is_some(), "{tool} {name}");
            for (i, found) in pixels.iter().flatten().enumerate() {
                let expected = color_at(keyframe.id, i % keyframe.image.width(), i / keyframe.image.width());
                assert!(is_near(*found, expected), "{tool} {name} at {i}: {found:?} for {expected:?}");
            }
        }
    }
    let points = fs::read_to_string(folder.path().join("colmap/sparse/0/points3D.txt")).unwrap();
    let is_colored = |line: &str| {
        let words: Vec<&str> = line.split(' ').collect();
        !line.starts_with('#') && words[4] != words[5]
    };
    assert!(points.lines().any(is_colored));
}
