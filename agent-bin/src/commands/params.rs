//! `loopbox params`: the default parameters as a TOML file, each documented.

use crate::console::{self, usage};
use anyhow::{Context, Result, anyhow, bail};
use loopbox::merging::MergingParams;
use serde::Serialize;
use serde::de::DeserializeOwned;
use slam_direct::{DocumentedParameter, Parameter, ParameterValue, Params};
use slam_lidar::mapping::MappingParams;
use std::borrow::Cow;
use std::fmt::Write as _;
use std::path::PathBuf;
use toml::{Table, Value};

/// Print the default parameters as a parameter file
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct ParamsArgs {
    /// Those of `loopbox merge`; else those of `loopbox run`
    #[arg(long, conflicts_with = "lidar")]
    merge: bool,
    /// Those of `loopbox run` over a LiDAR's scans
    #[arg(long)]
    lidar: bool,
}

impl ParamsArgs {
    fn text(self) -> Cow<'static, str> {
        match self {
            Self { lidar: true, .. } => MAPPING_FILE.into(),
            Self { merge: true, .. } => MERGING_FILE.into(),
            _ => default_file().into(),
        }
    }
}

/// Prints the defaults.
///
/// # Errors
/// None that matter: a closed pipe ends the output.
pub fn execute(args: ParamsArgs) -> Result<()> {
    // A reader that has closed the pipe (`| head`) has seen enough.
    console::print(&args.text())?;
    Ok(())
}

/// A setting as help shows it.
const EXAMPLE: &str = "align.max_iterations=20";

/// Where the parameters of a command come from.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ParameterArgs {
    /// Parameter file (TOML); `loopbox params` prints the defaults of runs, with --lidar those over LiDARs' scans, with --merge those of
    /// merging
    #[arg(long, value_name = "FILE")]
    params: Option<PathBuf>,
    #[arg(long, value_name = "KEY=VALUE", value_parser = Setting::parse, help = format!(
        "Give a parameter this value, in place of the default's and the file's, such as --set {EXAMPLE} of a run over images; for \
         each parameter once"
    ))]
    set: Vec<Setting>,
}

/// `a.b.c=value`.
#[derive(Clone, Debug)]
struct Setting {
    /// As it was given.
    text: String,
    table: Table,
}

impl Setting {
    fn parse(text: &str) -> Result<Self, String> {
        let (key, value) =
            text.split_once('=').ok_or_else(|| format!("{text}: give a parameter as KEY=VALUE"))?;
        // What is no TOML value is a name, which a shell leaves without its quotes.
        let named = || toml::from_str::<Table>(&format!("{key} = {value:?}"));
        let table = toml::from_str(&format!("{key} = {value}")).or_else(|_| named());
        let table =
            table.map_err(|_| format!("{key}: no name of a parameter, as `loopbox params` prints them"))?;
        Ok(Self { text: text.to_owned(), table })
    }
}

impl ParameterArgs {
    /// Whether any are given.
    pub fn are_given(&self) -> bool {
        self.params.is_some() || !self.set.is_empty()
    }

    /// Those of a run; what is not given keeps its default.
    ///
    /// # Errors
    /// Names the file, and the line with an unknown key or a value of the wrong type; or the setting.
    pub fn of_run(&self) -> Result<Params> {
        let params: Params = self.read("loopbox params")?;
        self.blamed(params.validate().map_err(Into::into))?;
        Ok(params)
    }

    /// Those of a run over scans.
    ///
    /// # Errors
    /// As [`of_run`](Self::of_run).
    pub fn of_scans(&self) -> Result<MappingParams> {
        let params = self.read("loopbox params --lidar")?;
        self.blamed(check_numbers(&params, &MappingParams::default()))?;
        Ok(params)
    }

    /// Those of merging.
    ///
    /// # Errors
    /// As [`of_run`](Self::of_run).
    pub fn of_merging(&self) -> Result<MergingParams> {
        let params = self.read("loopbox params --merge")?;
        self.blamed(check_numbers(&params, &MergingParams::default()))?;
        Ok(params)
    }

    /// A value that cannot be worked with is the file's fault or, of settings, that of the command.
    fn blamed(&self, checked: Result<()>) -> Result<()> {
        match (&self.params, self.set.is_empty()) {
            (Some(path), true) => checked.with_context(|| path.display().to_string()),
            _ => usage(checked),
        }
    }

    /// What the file and the settings say, in the form that `command` prints.
    fn read<P: DeserializeOwned>(&self, command: &str) -> Result<P> {
        let mut table = Table::new();
        if let Some(path) = &self.params {
            let text = std::fs::read_to_string(path)
                .with_context(|| format!("{}: cannot be read", path.display()))?;
            let hint = || {
                format!(
                    "{}: not a parameter file (`{command}` prints one with every parameter)",
                    path.display()
                )
            };
            // By itself first: its errors name lines.
            toml::from_str::<P>(&text).with_context(hint)?;
            table = toml::from_str(&text).with_context(hint)?;
        }
        let hint = |text: &str| format!("--set {text}: no such parameter or value (`{command}` prints all)");
        for setting in &self.set {
            overlay(&mut table, &setting.table);
            usage(of_table::<P>(&table).with_context(|| hint(&setting.text)))?;
        }
        of_table(&table).context("the defaults cannot be read")
    }
}

/// The parameters of a table, by its text: a second reader of all their types makes the program half a megabyte larger.
fn of_table<P: DeserializeOwned>(table: &Table) -> Result<P> {
    toml::from_str(&table.to_string()).map_err(|error| anyhow!(error.message().to_owned()))
}

/// Refuses numbers that cannot be worked with, of parameters that state no ranges: what is not finite, what is negative where the default
/// is not. A count of zero says that nothing of the kind is done.
fn check_numbers<P: Serialize>(params: &P, defaults: &P) -> Result<()> {
    let value = |params| Value::try_from(params).context("the parameters cannot be written as TOML");
    check_value("", &value(params)?, &value(defaults)?)
}

fn check_value(name: &str, value: &Value, default: &Value) -> Result<()> {
    let is_refused = match (value, default) {
        (Value::Table(values), Value::Table(defaults)) => {
            return defaults.iter().try_for_each(|(key, default)| {
                let path = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                values.get(key).map_or(Ok(()), |value| check_value(&path, value, default))
            });
        }
        (Value::Array(values), Value::Array(defaults)) => {
            return values
                .iter()
                .zip(defaults)
                .try_for_each(|(value, default)| check_value(name, value, default));
        }
        (Value::Integer(value), Value::Integer(default)) => *value < (*default).min(0),
        (Value::Float(value), Value::Float(default)) => {
            !value.is_finite() && default.is_finite() || *value < 0.0 && *default >= 0.0
        }
        _ => false,
    };
    if is_refused {
        bail!("parameter {name} = {value}: it must be a number of at least 0");
    }
    Ok(())
}

/// Puts the values of `changes` in place of those of `table`.
fn overlay(table: &mut Table, changes: &Table) {
    for (key, change) in changes {
        match (table.get_mut(key), change) {
            (Some(Value::Table(inner)), Value::Table(change)) => overlay(inner, change),
            _ => drop(table.insert(key.clone(), change.clone())),
        }
    }
}

/// The defaults with the documentation of their structs, which the test `documents` writes from the source.
const MERGING_FILE: &str = include_str!("parameters/merge.toml");
const MAPPING_FILE: &str = include_str!("parameters/lidar.toml");

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
    fn the_printed_files_for_merging_and_lidars_read_back_as_the_defaults() {
        assert_eq!(toml::from_str::<MergingParams>(MERGING_FILE).unwrap(), MergingParams::default());
        assert_eq!(toml::from_str::<MappingParams>(MAPPING_FILE).unwrap(), MappingParams::default());
    }

    #[test]
    fn each_parameter_has_a_comment_before_it() {
        for file in [&default_file(), MERGING_FILE, MAPPING_FILE] {
            let lines: Vec<&str> = file.lines().collect();
            let is_value = |line: &str| line.contains(" = ") && !line.starts_with('#');
            let bare = lines.windows(2).find(|two| is_value(two[1]) && !two[0].starts_with('#'));
            assert_eq!(bare, None);
        }
    }

    fn given(file: Option<&std::path::Path>, settings: &[&str]) -> ParameterArgs {
        let set = settings.iter().map(|text| Setting::parse(text).unwrap()).collect();
        ParameterArgs { params: file.map(Into::into), set }
    }

    #[test]
    fn settings_take_the_place_of_what_the_file_says_and_of_the_defaults() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("p.toml");
        std::fs::write(&file, "joint = false\n[further]\nmax_closures = 3\n").unwrap();
        let read = given(Some(&file), &["further.max_closures=4", "method=loop-box"]).of_merging().unwrap();
        let mut expected = MergingParams { joint: false, ..MergingParams::default() };
        expected.further.max_closures = 4;
        expected.method = merge::method::Method::LoopBox;
        assert_eq!(read, expected);
        assert_eq!(given(None, &[]).of_merging().unwrap(), MergingParams::default());
    }

    #[test]
    fn what_is_no_parameter_or_no_value_of_it_is_refused_by_name() {
        for wrong in ["further.no_such=1", "further.max_closures=many", "joint=7", "further=2"] {
            let error = format!("{:#}", given(None, &[wrong]).of_merging().unwrap_err());
            assert!(error.starts_with(&format!("--set {wrong}: no such parameter or value")), "{error}");
        }
        assert!(Setting::parse("joint").unwrap_err().contains("KEY=VALUE"));
        assert!(Setting::parse("a b=1").unwrap_err().contains("no name of a parameter"));
    }

    #[test]
    fn numbers_that_cannot_be_worked_with_are_refused() {
        for (setting, value) in [("rank.max_ratio=-0.5", "-0.5"), ("places.bow.min_score=inf", "inf")] {
            let error = format!("{:#}", given(None, &[setting]).of_merging().unwrap_err());
            let name = setting.split('=').next().unwrap();
            assert!(error.starts_with(&format!("parameter {name} = {value}: it must be")), "{error}");
        }
        let error = given(None, &["odometry.range=[-1.0, 100.0]"]).of_scans().unwrap_err();
        assert!(error.to_string().starts_with("parameter odometry.range = -1.0: it must be"), "{error}");
        let error = given(None, &["bootstrap.min_inliers=7.5"]).of_run().unwrap_err();
        assert!(error.to_string().contains("min_inliers = 7.5: it must be in the range 0.1 to 1"), "{error}");
        assert!(given(None, &[EXAMPLE]).of_run().is_ok());
        assert!(given(None, &[]).of_scans().is_ok() && given(None, &[]).of_merging().is_ok());
        assert!(
            given(None, &["further.max_closures=0"]).of_merging().is_ok(),
            "no further closure is sought"
        );
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
