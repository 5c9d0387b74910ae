//! `loopbox params`: the default parameters as a TOML file, those of a run documented.

use crate::console;
use anyhow::{Context, Result};
use loopbox::merging::MergingParams;
use serde::de::DeserializeOwned;
use slam_direct::{DocumentedParameter, Parameter, ParameterValue, Params};
use slam_lidar::mapping::MappingParams;
use std::fmt::Write as _;
use std::path::Path;

/// Print the default parameters as a parameter file
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct ParamsArgs {
    /// Those of `loopbox merge`; else those of `loopbox run`, documented
    #[arg(long, conflicts_with = "lidar")]
    merge: bool,
    /// Those of `loopbox run` over a LiDAR's scans
    #[arg(long)]
    lidar: bool,
}

impl ParamsArgs {
    fn text(self) -> Result<String> {
        match self {
            Self { lidar: true, .. } => mapping_file(),
            Self { merge: true, .. } => merging_file(),
            _ => Ok(default_file()),
        }
    }
}

/// Prints the defaults.
///
/// # Errors
/// None that matter: a closed pipe ends the output.
pub fn execute(args: ParamsArgs) -> Result<()> {
    // A reader that has closed the pipe (`| head`) has seen enough.
    console::print(&args.text()?)?;
    Ok(())
}

/// Reads a parameter file; what it does not name keeps its default.
///
/// # Errors
/// Names the file, and the line with an unknown key or a value of the wrong type.
pub fn read(path: &Path) -> Result<Params> {
    read_as(path, "loopbox params")
}

/// Reads a parameter file for LiDARs; what it does not name keeps its default.
///
/// # Errors
/// Names the file, and the line with an unknown key or a value of the wrong type.
pub fn read_mapping(path: &Path) -> Result<MappingParams> {
    read_as(path, "loopbox params --lidar")
}

/// Reads a parameter file for merging; what it does not name keeps its default.
///
/// # Errors
/// Names the file, and the line with an unknown key or a value of the wrong type.
pub fn read_merging(path: &Path) -> Result<MergingParams> {
    read_as(path, "loopbox params --merge")
}

/// Reads a file of the form that `command` prints.
fn read_as<P: DeserializeOwned>(path: &Path, command: &str) -> Result<P> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    toml::from_str(&text).with_context(|| {
        format!("{}: not a parameter file (`{command}` prints one with every parameter)", path.display())
    })
}

fn mapping_file() -> Result<String> {
    toml::to_string_pretty(&MappingParams::default()).context("the parameters cannot be written as TOML")
}

fn merging_file() -> Result<String> {
    let table = toml::to_string(&MergingParams::default()).context("the parameters cannot be printed")?;
    Ok(format!(
        "# Parameters of `loopbox merge` with their defaults. A file may name any part of them.\n\n{table}"
    ))
}

fn default_file() -> String {
    let mut out =
        String::from("# Parameters of loopbox with their defaults. A file may name any part of them.\n");
    write_table(&mut out, "", &Params::documented());
    out
}

/// Writes a table's own values first, as TOML wants it, then its sub-tables.
fn write_table(out: &mut String, path: &str, fields: &[DocumentedParameter]) {
    for field in fields {
        if let ParameterValue::Plain(value) = &field.default {
            write_doc(out, field);
            // Writing to a String cannot fail.
            let _ = writeln!(out, "{} = {value}", field.name);
        }
    }
    for field in fields {
        if let ParameterValue::Table(inner) = &field.default {
            let path = if path.is_empty() { field.name.to_owned() } else { format!("{path}.{}", field.name) };
            write_doc(out, field);
            let _ = writeln!(out, "[{path}]");
            write_table(out, &path, inner);
        }
    }
}

fn write_doc(out: &mut String, field: &DocumentedParameter) {
    out.push('\n');
    for line in &field.doc {
        let _ = writeln!(out, "#{}", line.trim_end());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_printed_file_reads_back_as_the_defaults() {
        assert_eq!(toml::from_str::<Params>(&default_file()).unwrap(), Params::default());
    }

    #[test]
    fn the_printed_file_for_merging_reads_back_as_the_defaults() {
        let file = merging_file().unwrap();
        assert_eq!(toml::from_str::<MergingParams>(&file).unwrap(), MergingParams::default());
    }

    #[test]
    fn tables_follow_their_parents_values() {
        let plain = |name, value: &str| DocumentedParameter {
            name,
            doc: vec![" What."],
            default: ParameterValue::Plain(value.into()),
        };
        let inner = DocumentedParameter {
            name: "inner",
            doc: vec![" A table.", "", " More."],
            default: ParameterValue::Table(vec![plain("b", "2.0")]),
        };
        let mut out = String::new();
        write_table(&mut out, "outer", &[inner, plain("a", "1")]);
        assert_eq!(out, "\n# What.\na = 1\n\n# A table.\n#\n# More.\n[outer.inner]\n\n# What.\nb = 2.0\n");
    }
}
