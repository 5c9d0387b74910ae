//! Parameter files of merging and LiDARs with the documentation of their structs, as the source has it: the program carries them along.

use crate::markdown::repository;
use loopbox::merging::MergingParams;
use serde::Serialize;
use slam_lidar::mapping::MappingParams;
use std::collections::BTreeMap;
use std::fs;

const ASKED: &str = "LOOPBOX_WRITE_BOOK";

/// A field as its struct has it.
#[derive(Clone, Debug, Default, PartialEq)]
struct Field {
    kind: String,
    /// Line by line, each with the blank that opens a doc comment.
    doc: Vec<String>,
}

/// A struct's fields by their keys in files.
type Fields = BTreeMap<String, Field>;
/// The structs of a name, each with the crate that it is in.
type Structs = BTreeMap<String, Vec<(String, Fields)>>;

/// Adds the structs of a source file, as rustfmt writes them; also those of `params!`.
fn read_structs(text: &str, of_crate: &str, structs: &mut Structs) {
    let (mut doc, mut key, mut open) = (Vec::new(), None, None::<String>);
    for line in text.lines().map(str::trim) {
        let renamed = line.strip_prefix("#[key = \"").or(line.strip_prefix("#[serde(rename = \""));
        if let Some(text) = line.strip_prefix("///") {
            doc.push(text.to_owned());
            continue;
        } else if let Some((name, _)) = renamed.and_then(|rest| rest.split_once('"')) {
            key = Some(name.to_owned());
            continue;
        } else if line.starts_with("#[") {
            continue;
        }
        let name = line.strip_prefix("pub struct ").and_then(|rest| rest.strip_suffix(" {"));
        let field = line.strip_prefix("pub ").and_then(|rest| rest.split_once(": "));
        if let Some(name) = name {
            structs.entry(name.to_owned()).or_default().push((of_crate.to_owned(), Fields::new()));
            open = Some(name.to_owned());
        } else if line == "}" {
            open = None;
        } else if let (Some((own, rest)), Some(name)) = (field, &open) {
            let kind = rest.split(" = ").next().unwrap_or_default().trim_end_matches(',').to_owned();
            let fields = structs.get_mut(name).and_then(|all| all.last_mut());
            let field = Field { kind, doc: std::mem::take(&mut doc) };
            fields.expect("it is open").1.insert(key.take().unwrap_or(own.to_owned()), field);
        }
        (doc, key) = (Vec::new(), None);
    }
}

/// The structs of all crates.
fn structs() -> Structs {
    let mut structs = Structs::new();
    let crates = fs::read_dir(repository()).expect("a folder").flatten().map(|entry| entry.path());
    for folder in crates.filter(|path| path.join("Cargo.toml").is_file()) {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut folders = vec![folder.join("src")];
        while let Some(folder) = folders.pop() {
            let entries = fs::read_dir(&folder).into_iter().flatten().flatten();
            for path in entries.map(|entry| entry.path()) {
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|ending| ending == "rs") {
                    read_structs(&fs::read_to_string(&path).expect("source"), &name, &mut structs);
                }
            }
        }
    }
    structs
}

/// The struct of this name that has a field of this key; rather that of the same crate as what it is a part of.
fn with<'a>(structs: &'a Structs, kind: &str, key: &str, near: &str) -> Option<&'a (String, Fields)> {
    let kind = kind.strip_prefix("Option<").map_or(kind, |inner| inner.trim_end_matches('>'));
    let mut found =
        structs.get(kind.rsplit("::").next()?)?.iter().filter(|(_, fields)| fields.contains_key(key));
    found.clone().find(|(of, _)| of == near).or_else(|| found.next())
}

/// The field at a path of keys below a struct.
fn field<'a>(structs: &'a Structs, root: &str, path: &[&str]) -> &'a Field {
    let (mut kind, mut near, mut found) = (root, "loopbox", None);
    for key in path {
        let (of, fields) =
            with(structs, kind, key, near).unwrap_or_else(|| panic!("{kind} of {root} has no {key}"));
        let field = &fields[*key];
        (kind, near, found) = (&field.kind, of, Some(field));
    }
    found.expect("a path has keys")
}

/// Documentation as comments: links of Rust's become their texts.
fn comment(doc: &[String]) -> String {
    let plain = |line: &String| {
        let mut parts = line.split('[');
        let mut text = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            match part.split_once(']') {
                Some((label, rest)) if label.starts_with('`') || rest.starts_with('(') => {
                    let behind = rest.strip_prefix('(').and_then(|rest| rest.split_once(')'));
                    text += label;
                    text += behind.map_or(rest, |(_, behind)| behind);
                }
                _ => text = format!("{text}[{part}"),
            }
        }
        format!("#{}\n", text.trim_end())
    };
    doc.iter().map(plain).collect()
}

/// The file of default parameters with a comment before each.
fn annotated<P: Serialize>(head: &str, defaults: &P, root: &str, structs: &Structs) -> String {
    let mut file = format!("# {head} A file may name any part of them.\n");
    let mut table = Vec::new();
    let text = toml::to_string(defaults).expect("TOML");
    for line in text.lines().filter(|line| !line.is_empty()) {
        let header = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        let path = match header {
            Some(path) => {
                table = path.split('.').collect();
                table.clone()
            }
            None => {
                let key = line.split(" = ").next().unwrap_or_default();
                table.iter().copied().chain([key]).collect()
            }
        };
        let doc = &field(structs, root, &path).doc;
        assert!(!doc.is_empty(), "{} of {root} is not documented", path.join("."));
        file += &format!("\n{}{line}\n", comment(doc));
    }
    file
}

fn write_or_compare(name: &str, new: &str) {
    let path = repository().join("agent-bin/src/commands/parameters").join(name);
    if std::env::var_os(ASKED).is_some() {
        return fs::write(path, new).expect("it can be written");
    }
    let is_current = fs::read_to_string(&path).is_ok_and(|old| old == new);
    assert!(is_current, "{name} is not what the source says: `script/book` writes it anew; then build again");
}

#[test]
fn the_files_of_parameters_say_what_the_source_does() {
    let structs = structs();
    let head = "Parameters of `loopbox merge` with their defaults.";
    write_or_compare("merge.toml", &annotated(head, &MergingParams::default(), "MergingParams", &structs));
    let head = "Parameters of `loopbox run` over a LiDAR's scans with their defaults.";
    write_or_compare("lidar.toml", &annotated(head, &MappingParams::default(), "MappingParams", &structs));
}

#[test]
fn structs_are_read_with_keys_and_links() {
    let mut structs = Structs::new();
    let text = "/// A.\n#[derive(Clone)]\npub struct Outer {\n    /// How [`far`](crate::far), [m]; see [there](x).\n    #[serde(rename = \"old\")]\n    \
                pub new: f64,\n    /// In.\n    pub inner: crate::Inner = Inner::default(),\n}\n";
    read_structs(text, "one", &mut structs);
    read_structs("pub struct Inner {\n    /// B.\n    pub b: usize,\n}\n", "two", &mut structs);
    let found = field(&structs, "Outer", &["old"]);
    assert_eq!((&*found.kind, &*comment(&found.doc)), ("f64", "# How `far`, [m]; see there.\n"));
    assert_eq!(field(&structs, "Outer", &["inner", "b"]).doc, [" B."]);
}
