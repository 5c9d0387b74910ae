//! The schema of loopbox's own messages, so that any MCAP tool can read a map without loopbox.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

/// Name, number, type, and whether there are many.
type Field = (&'static str, i32, Type, bool);

/// Name of the keyframe message's schema.
pub(super) const KEYFRAME_SCHEMA: &str = "loopbox.Keyframe";
/// Name of the features message's schema.
pub(super) const FEATURES_SCHEMA: &str = "loopbox.Features";
/// Name of the graph message's schema.
pub(super) const GRAPH_SCHEMA: &str = "loopbox.Graph";

const KEYFRAME_FIELDS: [Field; 16] = [
    ("id", 1, Type::Uint32, false),
    ("timestamp", 2, Type::Double, false),
    ("frame_index", 3, Type::Uint64, false),
    ("world_from_keyframe", 4, Type::Double, true),
    ("pixel_step", 5, Type::Uint32, true),
    ("inverse_depth", 6, Type::Float, true),
    ("variance", 7, Type::Float, true),
    ("point_pixel", 8, Type::Float, true),
    ("point_inverse_depth", 9, Type::Float, true),
    ("point_variance", 10, Type::Float, true),
    ("point_observation_count", 11, Type::Uint32, true),
    ("observation_keyframe", 12, Type::Uint32, true),
    ("observation_pixel", 13, Type::Float, true),
    ("observation_information", 14, Type::Float, true),
    ("agent", 15, Type::Uint32, false),
    ("own_world_from_keyframe", 16, Type::Double, true),
];

const FEATURES_FIELDS: [Field; 3] =
    [("keyframe", 1, Type::Uint32, false), ("data", 2, Type::Bytes, false), ("words", 3, Type::Bytes, false)];

const GRAPH_FIELDS: [Field; 14] = [
    ("keyframe_id", 1, Type::Uint32, true),
    ("world_from_keyframe", 2, Type::Double, true),
    ("removed_keyframe", 3, Type::Uint32, true),
    ("edge_offset", 4, Type::Uint64, false),
    ("edge_from", 5, Type::Uint32, true),
    ("edge_to", 6, Type::Uint32, true),
    ("edge_kind", 7, Type::Uint32, true),
    ("edge_from_from_to", 8, Type::Double, true),
    ("edge_information", 9, Type::Double, true),
    ("frame_offset", 10, Type::Uint64, false),
    ("frame_timestamp", 11, Type::Double, true),
    ("frame_index", 12, Type::Uint64, true),
    ("frame_reference", 13, Type::Uint32, true),
    ("keyframe_from_frame", 14, Type::Double, true),
];

const SCAN_FIELDS: [Field; 2] = [("id", 1, Type::Uint32, false), ("cell_step", 2, Type::Uint64, true)];

const COLOR_FIELDS: [Field; 3] =
    [("keyframe", 1, Type::Uint32, false), ("luma", 2, Type::Uint32, false), ("jpeg", 3, Type::Bytes, false)];

/// The protobuf `FileDescriptorSet` of keyframes, features and the graph, as MCAP's schema encoding `protobuf` asks for.
pub(super) fn descriptor_set() -> Vec<u8> {
    descriptors(vec![
        message("Keyframe", &KEYFRAME_FIELDS),
        message("Features", &FEATURES_FIELDS),
        message("Graph", &GRAPH_FIELDS),
    ])
}

/// That of the message of a scan.
pub(super) fn scan_descriptor_set() -> Vec<u8> {
    descriptors(vec![message("Scan", &SCAN_FIELDS)])
}

/// That of the message of a keyframe's colours.
pub(super) fn color_descriptor_set() -> Vec<u8> {
    descriptors(vec![message("Color", &COLOR_FIELDS)])
}

/// Messages of one file.
fn descriptors(message_type: Vec<DescriptorProto>) -> Vec<u8> {
    let file = FileDescriptorProto {
        name: Some("loopbox.proto".into()),
        package: Some("loopbox".into()),
        syntax: Some("proto3".into()),
        message_type,
        ..Default::default()
    };
    FileDescriptorSet { file: vec![file] }.encode_to_vec()
}

/// The description of one message.
fn message(name: &str, fields: &[Field]) -> DescriptorProto {
    DescriptorProto {
        name: Some(name.into()),
        field: fields.iter().map(field).collect(),
        ..Default::default()
    }
}

/// The description of one field.
fn field(&(name, number, kind, many): &Field) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.into()),
        number: Some(number),
        r#type: Some(kind as i32),
        label: Some(if many { Label::Repeated } else { Label::Optional } as i32),
        ..Default::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::messages::{FeaturesMessage, GraphMessage, KeyframeMessage};
    use prost::encoding::{DecodeContext, WireType, decode_key, decode_varint, skip_field};
    use std::fmt::Write as _;

    /// Bytes a value of the type takes at least, as far as these messages use it.
    fn unit(kind: Type) -> usize {
        match kind {
            Type::Double => 8,
            Type::Float => 4,
            _ => 1,
        }
    }

    /// Asserts that encoded `bytes` hold every field of the table once, in the table's wire form.
    fn assert_described(mut bytes: &[u8], fields: &[Field]) {
        for &(name, number, kind, many) in fields {
            let (tag, wire) = decode_key(&mut bytes).unwrap();
            assert_eq!(tag as i32, number, "{name}");
            if many {
                assert_eq!(wire, WireType::LengthDelimited, "{name}");
                let length = decode_varint(&mut &bytes[..]).unwrap();
                assert_eq!(length as usize, 3 * unit(kind), "{name}");
            } else {
                let expected = match kind {
                    Type::Double => WireType::SixtyFourBit,
                    Type::Bytes => WireType::LengthDelimited,
                    _ => WireType::Varint,
                };
                assert_eq!(wire, expected, "{name}");
            }
            skip_field(wire, tag, &mut bytes, DecodeContext::default()).unwrap();
        }
        assert!(bytes.is_empty());
    }

    #[test]
    fn the_schema_describes_what_is_written() {
        let keyframe = KeyframeMessage {
            id: 1,
            timestamp: 1.0,
            frame_index: 1,
            world_from_keyframe: vec![1.0; 3],
            pixel_step: vec![1; 3],
            inverse_depth: vec![1.0; 3],
            variance: vec![1.0; 3],
            point_pixel: vec![1.0; 3],
            point_inverse_depth: vec![1.0; 3],
            point_variance: vec![1.0; 3],
            point_observation_count: vec![1; 3],
            observation_keyframe: vec![1; 3],
            observation_pixel: vec![1.0; 3],
            observation_information: vec![1.0; 3],
            agent: 1,
            own_world_from_keyframe: vec![1.0; 3],
        };
        assert_described(&keyframe.encode_to_vec(), &KEYFRAME_FIELDS);
        let features = FeaturesMessage { keyframe: 1, data: vec![1, 2], words: vec![1] };
        assert_described(&features.encode_to_vec(), &FEATURES_FIELDS);
        let graph = GraphMessage {
            keyframe_id: vec![1; 3],
            world_from_keyframe: vec![1.0; 3],
            removed_keyframe: vec![1; 3],
            edge_offset: 1,
            edge_from: vec![1; 3],
            edge_to: vec![1; 3],
            edge_kind: vec![1; 3],
            edge_from_from_to: vec![1.0; 3],
            edge_information: vec![1.0; 3],
            frame_offset: 1,
            frame_timestamp: vec![1.0; 3],
            frame_index: vec![1; 3],
            frame_reference: vec![1; 3],
            keyframe_from_frame: vec![1.0; 3],
        };
        assert_described(&graph.encode_to_vec(), &GRAPH_FIELDS);
        let scan = crate::io::scan::ScanMessage { id: 1, cell_step: vec![1; 3] };
        assert_described(&scan.encode_to_vec(), &SCAN_FIELDS);
        let color = crate::io::color::ColorMessage { keyframe: 1, luma: 1, jpeg: vec![1] };
        assert_described(&color.encode_to_vec(), &COLOR_FIELDS);
    }

    /// The messages as a `.proto` file.
    fn as_text(messages: &[(&str, &[Field])]) -> String {
        let mut out = "// The messages of loopbox in map.mcap; what the fields mean stands in map-format.md. `script/book` writes this file.\n\
                       syntax = \"proto3\";\n\npackage loopbox;\n"
            .to_owned();
        for (name, fields) in messages {
            let _ = writeln!(out, "\nmessage {name} {{");
            for (name, number, kind, many) in *fields {
                let kind = kind.as_str_name().trim_start_matches("TYPE_").to_lowercase();
                let many = if *many { "repeated " } else { "" };
                let _ = writeln!(out, "  {many}{kind} {name} = {number};");
            }
            out.push_str("}\n");
        }
        out
    }

    #[test]
    fn the_book_has_the_schema() {
        let new = as_text(&[
            ("Keyframe", &KEYFRAME_FIELDS),
            ("Features", &FEATURES_FIELDS),
            ("Graph", &GRAPH_FIELDS),
            ("Scan", &SCAN_FIELDS),
            ("Color", &COLOR_FIELDS),
        ]);
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../book/src/reference/map.proto");
        if std::env::var_os("LOOPBOX_WRITE_BOOK").is_some() {
            std::fs::write(&path, &new).unwrap();
        }
        assert_eq!(
            std::fs::read_to_string(&path).unwrap_or_default(),
            new,
            "`script/book` writes map.proto anew"
        );
    }

    /// Rows of the page: number, name, type and whether there are many.
    #[test]
    fn the_page_has_the_fields() {
        let page = include_str!("../../../book/src/reference/map-format.md");
        for (name, fields) in [
            ("Keyframe", &KEYFRAME_FIELDS[..]),
            ("Features", &FEATURES_FIELDS),
            ("Graph", &GRAPH_FIELDS),
            ("Scan", &SCAN_FIELDS),
            ("Color", &COLOR_FIELDS),
        ] {
            let (_, section) = page.split_once(&format!("`loopbox.{name}`")).expect(name);
            let section = section.split("\n#").next().unwrap();
            let rows = section.lines().filter(|line| line.starts_with("| ")).count() - 1;
            assert_eq!(rows, fields.len(), "{name}");
            for (field, number, kind, many) in fields {
                let kind = kind.as_str_name().trim_start_matches("TYPE_").to_lowercase();
                let row = format!("| {number} | `{field}` | {kind}{} ", if *many { " ×" } else { "" });
                assert!(section.contains(&row), "{name}: no row {row}");
            }
        }
    }
}
