//! OpenCV's FileStorage as XML, turned into the YAML that it writes of the same.

use crate::CalibError;
use roxmltree::{Document, Node, ParsingOptions};
use std::fmt::Write;

/// How deep elements may lie: FileStorage has three levels.
const DEEPEST: usize = 16;

/// Whether the text is XML.
pub(crate) fn is_xml(text: &str) -> bool {
    let text = text.trim_start();
    text.starts_with("<?xml") || text.starts_with("<opencv_storage")
}

/// The same as YAML.
pub(crate) fn to_yaml(text: &str, file: &str) -> Result<String, CalibError> {
    let options = ParsingOptions { nodes_limit: 100_000, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options).map_err(|error| CalibError::Syntax {
        file: file.into(),
        message: format!("nor valid XML: {error}"),
    })?;
    if !document.root_element().has_tag_name("opencv_storage") {
        return Err(CalibError::UnknownForm { file: file.into() });
    }
    let mut yaml = String::new();
    elements(&document.root_element(), 0, &mut yaml);
    Ok(yaml)
}

fn elements(parent: &Node, depth: usize, yaml: &mut String) {
    for node in parent.children().filter(Node::is_element).take_while(|_| depth < DEEPEST) {
        let name = node.tag_name().name();
        let _ = write!(yaml, "{:1$}{name}:", "", 2 * depth);
        if node.children().any(|child| child.is_element()) {
            yaml.push('\n');
            elements(&node, depth + 1, yaml);
            continue;
        }
        let text = node.text().unwrap_or("").trim();
        let words: Vec<&str> = text.split_whitespace().collect();
        let are_numbers = words.iter().all(|word| word.parse::<f64>().is_ok());
        let _ = match (are_numbers, words.len(), name) {
            (true, 1, "data") | (true, 2.., _) => writeln!(yaml, " [{}]", words.join(", ")),
            (true, 1, _) => writeln!(yaml, " {text}"),
            _ => writeln!(yaml, " {:?}", text.trim_matches('"')),
        };
    }
}
