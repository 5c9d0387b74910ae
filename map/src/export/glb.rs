//! Binary glTF, which browsers, phones and Blender show: the cloud, and each agent's trajectory as a line.

use super::{CloudPoint, CloudSelection, Columns, Extent, agent_color, save};
use crate::{Map, MapError};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};
use std::io::{self, Write};
use std::path::Path;

/// A point's position, three floats, and colour, four bytes.
const POINT_BYTES: usize = 16;
/// A position.
const VERTEX_BYTES: usize = 12;
/// What glTF calls its constants: a buffer of vertices, floats, bytes, points, a line.
const ARRAY_BUFFER: u32 = 34962;
const FLOAT: u32 = 5126;
const UNSIGNED_BYTE: u32 = 5121;
const POINTS: u32 = 0;
const LINE_STRIP: u32 = 3;

/// Makes a binary glTF 2.0 file: points with colours as in [`save_ply`](super::save_ply), and the trajectory of each
/// agent as a line in its colour. `gltf_from_world` turns the map's world to glTF's axes: y up, and z towards the
/// viewer. Lengths are those of the map. Returns the number of points.
///
/// # Errors
/// When the file cannot be written, or is larger than the 4 GiB that the format can have.
pub fn save_glb(
    path: impl AsRef<Path>,
    map: &Map,
    selection: impl Into<CloudSelection>,
    gltf_from_world: UnitQuaternion<f64>,
) -> Result<usize, MapError> {
    let selection = selection.into();
    save(path.as_ref(), |out| write(out, map, selection, &gltf_from_world))
}

fn write(
    out: &mut impl Write,
    map: &Map,
    selection: CloudSelection,
    gltf_from_world: &UnitQuaternion<f64>,
) -> io::Result<usize> {
    let columns = Columns::of(map);
    let cloud = Extent::of(selection.points(map).map(|point| point.position));
    let paths: Vec<(String, [u8; 3], Vec<Vector3<f64>>)> = map
        .agent_labels()
        .into_iter()
        .map(|(agent, label)| {
            let poses = map.trajectory_of(agent);
            (label, agent_color(agent), poses.iter().map(|pose| pose.world_from_camera.translation).collect())
        })
        .filter(|(.., path): &(_, _, Vec<_>)| path.len() > 1)
        .collect();
    let mut scene = Scene::new(gltf_from_world);
    if cloud.count > 0 {
        scene.add_cloud(&cloud);
    }
    for (label, color, path) in &paths {
        scene.add_line(label, *color, &Extent::of(path.iter().copied()));
    }
    let length = scene.length;
    let mut text = scene.into_json().to_string();
    // Both parts are whole in fours of bytes.
    text.push_str(&" ".repeat(text.len().wrapping_neg() % 4));
    let parts = [8 + text.len(), 8 + length];
    let total = u32::try_from(12 + parts.iter().sum::<usize>())
        .map_err(|_| io::Error::other("a glTF file holds 4 GiB at most; thin the cloud by --voxel"))?;
    let word = |number: usize| (number as u32).to_le_bytes();
    out.write_all(&[&b"glTF"[..], &2u32.to_le_bytes(), &total.to_le_bytes()].concat())?;
    out.write_all(&[&word(text.len())[..], b"JSON", text.as_bytes()].concat())?;
    out.write_all(&[&word(length)[..], b"BIN\0"].concat())?;
    for point in selection.points(map) {
        out.write_all(&vertex(&point.position))?;
        out.write_all(&color_of(&point, columns))?;
    }
    for position in paths.iter().flat_map(|(.., path)| path) {
        out.write_all(&vertex(position))?;
    }
    Ok(cloud.count)
}

/// The parts of a glTF file that stand in its text.
struct Scene {
    rotation: [f32; 4],
    /// Bytes of the buffer so far.
    length: usize,
    views: Vec<Value>,
    accessors: Vec<Value>,
    materials: Vec<Value>,
    meshes: Vec<Value>,
}

impl Scene {
    fn new(gltf_from_world: &UnitQuaternion<f64>) -> Self {
        let rotation = gltf_from_world.coords.cast().into();
        let (views, accessors, materials, meshes) = Default::default();
        Self { rotation, length: 0, views, accessors, materials, meshes }
    }

    fn add_cloud(&mut self, extent: &Extent) {
        self.view(extent.count * POINT_BYTES, Some(POINT_BYTES));
        let position = self.positions(extent);
        self.accessors.push(json!({
            "bufferView": self.views.len() - 1, "byteOffset": VERTEX_BYTES, "componentType": UNSIGNED_BYTE,
            "normalized": true, "count": extent.count, "type": "VEC4",
        }));
        let attributes = json!({ "POSITION": position, "COLOR_0": position + 1 });
        self.mesh("cloud", attributes, POINTS, [1.0; 3]);
    }

    fn add_line(&mut self, label: &str, color: [u8; 3], extent: &Extent) {
        self.view(extent.count * VERTEX_BYTES, None);
        let position = self.positions(extent);
        self.mesh(
            &format!("trajectory of {label}"),
            json!({ "POSITION": position }),
            LINE_STRIP,
            color.map(|level| f64::from(linear(level)) / 255.0),
        );
    }

    fn view(&mut self, length: usize, stride: Option<usize>) {
        let mut view = json!({
            "buffer": 0, "byteOffset": self.length, "byteLength": length, "target": ARRAY_BUFFER,
        });
        if let Some(stride) = stride {
            view["byteStride"] = json!(stride);
        }
        self.views.push(view);
        self.length += length;
    }

    /// The accessor of positions at the begin of the last view.
    fn positions(&mut self, extent: &Extent) -> usize {
        let [least, most] = [extent.least, extent.most].map(|corner| <[f32; 3]>::from(corner.cast()));
        self.accessors.push(json!({
            "bufferView": self.views.len() - 1, "componentType": FLOAT, "count": extent.count,
            "type": "VEC3", "min": least, "max": most,
        }));
        self.accessors.len() - 1
    }

    fn mesh(&mut self, name: &str, attributes: Value, mode: u32, color: [f64; 3]) {
        let [red, green, blue] = color;
        self.materials.push(json!({
            "extensions": { "KHR_materials_unlit": {} },
            "pbrMetallicRoughness": { "baseColorFactor": [red, green, blue, 1.0] },
        }));
        let primitive =
            json!({ "attributes": attributes, "mode": mode, "material": self.materials.len() - 1 });
        self.meshes.push(json!({ "name": name, "primitives": [primitive] }));
    }

    fn into_json(self) -> Value {
        let count = self.meshes.len();
        let nodes = (0..count).map(|mesh| json!({ "mesh": mesh, "rotation": self.rotation }));
        let mut scene = json!({
            "asset": { "version": "2.0", "generator": concat!("loopbox ", env!("CARGO_PKG_VERSION")) },
            "scene": 0,
            "scenes": [{}],
        });
        // An empty list is against the format.
        if count > 0 {
            scene["extensionsUsed"] = json!(["KHR_materials_unlit"]);
            scene["scenes"] = json!([{ "nodes": (0..count).collect::<Vec<_>>() }]);
            scene["nodes"] = nodes.collect();
            scene["buffers"] = json!([{ "byteLength": self.length }]);
            scene["bufferViews"] = Value::Array(self.views);
            scene["accessors"] = Value::Array(self.accessors);
            scene["materials"] = Value::Array(self.materials);
            scene["meshes"] = Value::Array(self.meshes);
        }
        scene
    }
}

fn vertex(position: &Vector3<f64>) -> [u8; VERTEX_BYTES] {
    let mut bytes = [0; VERTEX_BYTES];
    for (part, value) in bytes.chunks_exact_mut(4).zip(position.iter()) {
        part.copy_from_slice(&(*value as f32).to_le_bytes());
    }
    bytes
}

/// A point's colour and opacity; glTF wants light in linear steps. LiDARs' points are light grey.
fn color_of(point: &CloudPoint, columns: Columns) -> [u8; 4] {
    const LIGHT_GREY: u8 = 200;
    let color = if columns.colors() { columns.color(point) } else { [LIGHT_GREY; 3] };
    let [red, green, blue] = color.map(linear);
    [red, green, blue, u8::MAX]
}

/// A level of sRGB as light (IEC 61966-2-1), both 0–255.
fn linear(level: u8) -> u8 {
    let value = f64::from(level) / 255.0;
    let light = if value <= 0.040_45 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) };
    (255.0 * light).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{sample_map, united};

    /// The text and the buffer of a file.
    fn parts(map: &Map) -> (Value, Vec<u8>, usize) {
        let mut bytes = Vec::new();
        let half = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let count = write(&mut bytes, map, f32::INFINITY.into(), &half).unwrap();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
        let end = 20 + word(12);
        assert_eq!((&bytes[16..20], &bytes[end + 4..end + 8], end % 4), (&b"JSON"[..], &b"BIN\0"[..], 0));
        assert_eq!(word(end), bytes.len() - end - 8);
        (serde_json::from_slice(&bytes[20..end]).unwrap(), bytes[end + 8..].to_vec(), count)
    }

    #[test]
    fn points_and_trajectory_are_where_the_text_says() {
        let map = sample_map(2);
        let (text, buffer, count) = parts(&map);
        let first = map.cloud(f32::INFINITY).next().unwrap();
        let float = |at: usize| f32::from_le_bytes(buffer[at..at + 4].try_into().unwrap());
        assert_eq!([0, 1, 2].map(|i| float(4 * i)), [0, 1, 2].map(|i| first.position[i] as f32));
        assert_eq!(buffer[12..16], [[linear(first.intensity); 3].as_slice(), &[255]].concat());
        assert_eq!(text["accessors"][0]["count"], count);
        assert_eq!(text["buffers"][0]["byteLength"], buffer.len());
        let line = &text["bufferViews"][1];
        assert_eq!(
            (&line["byteOffset"], &line["byteLength"]),
            (&json!(16 * count), &json!(buffer.len() - 16 * count))
        );
        let agent = *map.agents.keys().next().unwrap();
        let last = map.trajectory_of(agent).last().unwrap().world_from_camera.translation;
        assert_eq!(float(buffer.len() - 4), last.z as f32);
        let rotation: Vec<f64> = serde_json::from_value(text["nodes"][0]["rotation"].clone()).unwrap();
        assert!((rotation[0].abs() - 1.0).abs() < 1e-6, "half a turn about x: {rotation:?}");
        for axis in 0..3 {
            let values = map.cloud(f32::INFINITY).map(|point| point.position[axis] as f32);
            let least = values.fold(f32::INFINITY, f32::min);
            assert_eq!(text["accessors"][0]["min"][axis].as_f64().unwrap() as f32, least);
        }
    }

    #[test]
    fn each_agent_has_a_line_in_its_colour_and_an_empty_map_is_a_file() {
        let map = united();
        let (text, ..) = parts(&map);
        let meshes = text["meshes"].as_array().unwrap();
        let lines = map.agents.keys().filter(|agent| map.trajectory_of(**agent).len() > 1).count();
        assert_eq!(meshes.len(), 1 + lines);
        let (text, buffer, count) = parts(&sample_map(0));
        assert!(text["meshes"].is_null() && buffer.is_empty() && count == 0, "{text}");
    }

    #[test]
    fn light_is_linear() {
        assert_eq!([0, 10, 128, 255].map(linear), [0, 1, 55, 255]);
    }
}
