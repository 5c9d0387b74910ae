//! Pages that the program writes: `script/book` writes them anew.

use crate::common::{command, stdout};
use crate::markdown::repository;
use std::fs;
use std::process::Stdio;

const ASKED: &str = "LOOPBOX_WRITE_BOOK";
const COMMANDS: &str = "book/src/reference/cli.md";
const PARAMETERS: &str = "book/src/reference/parameters.md";

/// What the program prints, for lines of 100 characters.
fn printed(args: &[&str]) -> String {
    let output = command().args(args).env("COLUMNS", "100").stdin(Stdio::null()).output().expect("it starts");
    assert!(output.status.success(), "{args:?}");
    let lines: Vec<String> = stdout(&output).lines().map(|line| line.trim_end().to_owned()).collect();
    lines.join("\n")
}

/// Names of the commands below the one given, as its help lists them.
fn below(help: &str) -> Vec<String> {
    let listed =
        help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let name = |line: &str| Some(line.strip_prefix("  ")?.split(' ').next()?.to_owned());
    listed.filter_map(name).filter(|name| !name.is_empty() && name != "help").collect()
}

/// Headings and texts: the program's help, and that of every command.
fn help() -> Vec<(String, String)> {
    let mut sections = Vec::new();
    let mut paths = vec![Vec::<String>::new()];
    while let Some(path) = paths.pop() {
        let mut args: Vec<&str> = path.iter().map(String::as_str).collect();
        args.push("--help");
        let text = printed(&args);
        paths.extend(below(&text).into_iter().rev().map(|name| [path.clone(), vec![name]].concat()));
        sections.push((format!("loopbox {}", path.join(" ")).trim_end().to_owned(), text));
    }
    sections
}

/// A section of a page as it is, by its heading.
fn section<'a>(page: &'a str, heading: &str) -> Option<&'a str> {
    let (_, rest) = page.split_once(&format!("\n## {heading}\n\n```text\n"))?;
    rest.split_once("\n```\n").map(|(text, _)| text)
}

fn write_or_compare(name: &str, is_equal: impl Fn(&str) -> Result<(), String>, new: &str) {
    let path = repository().join(name);
    if std::env::var_os(ASKED).is_some() {
        return fs::write(&path, new).expect("it can be written");
    }
    let old = fs::read_to_string(&path).unwrap_or_default();
    if let Err(what) = is_equal(&old) {
        panic!("{name} is not what the program says of {what}: `script/book` writes it anew");
    }
}

#[test]
fn the_command_line() {
    let sections = help();
    assert!(sections.len() > 20, "{} commands", sections.len());
    let mut page = "# Command line\n\nThe program's `--help`, with the features that are on by default. `script/book` writes this page.\n".to_owned();
    for (heading, text) in &sections {
        page += &format!("\n## {heading}\n\n```text\n{text}\n```\n");
    }
    let equal = |old: &str| {
        for (heading, text) in &sections {
            if section(old, heading) != Some(text) {
                return Err(format!("`{heading} --help`"));
            }
        }
        let more = old.matches("\n## ").count() != sections.len();
        if more { Err("commands that are no longer there".to_owned()) } else { Ok(()) }
    };
    write_or_compare(COMMANDS, equal, &page);
}

#[test]
fn the_parameters() {
    let mut page = "# Parameters\n\nThe defaults. A file for `--params` may name any part of them. `script/book` writes this page.\n".to_owned();
    for (title, arguments) in [
        ("`run`, camera", &["params"][..]),
        ("`run`, LiDAR", &["params", "--lidar"]),
        ("`merge`", &["params", "--merge"]),
    ] {
        page += &format!(
            "\n## {title}\n\n`loopbox {}`:\n\n```toml\n{}\n```\n",
            arguments.join(" "),
            printed(arguments)
        );
    }
    let equal = |old: &str| if old == page { Ok(()) } else { Err("`loopbox params`".to_owned()) };
    write_or_compare(PARAMETERS, equal, &page);
}

#[test]
fn sections_are_found() {
    let page = "# T\n\n## loopbox\n\n```text\na\nb\n```\n\n## loopbox run\n\n```text\nc\n```\n";
    assert_eq!(section(page, "loopbox"), Some("a\nb"));
    assert_eq!(section(page, "loopbox run"), Some("c"));
    assert_eq!(section(page, "loopbox no"), None);
}
