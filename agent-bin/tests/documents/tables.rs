//! Tables that name tests and messages name ones that there are.

use crate::markdown::{everything, read, repository, rows};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// The text of every Rust file of these folders.
fn sources(folders: &[&str]) -> Vec<String> {
    fn collect(folder: &Path, into: &mut Vec<String>) {
        for entry in fs::read_dir(folder).expect("the folder is there") {
            let path = entry.expect("it can be listed").path();
            if path.is_dir() {
                collect(&path, into);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                into.push(fs::read_to_string(&path).expect("it is text"));
            }
        }
    }
    let mut found = Vec::new();
    folders.iter().for_each(|folder| collect(&repository().join(folder), &mut found));
    found
}

/// Names of functions below `#[test]`.
fn tests(texts: &[String]) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for text in texts {
        let mut is_test = false;
        for line in text.lines().map(str::trim) {
            is_test |= line == "#[test]";
            if let Some(rest) = line.strip_prefix("fn ").filter(|_| is_test) {
                found.extend(rest.split_once('(').map(|(name, _)| name.to_owned()));
                is_test = false;
            }
        }
    }
    found
}

#[test]
fn each_format_names_a_test() {
    let there = tests(&sources(&["sources/src", "scans/src", "calib/src", "agent-bin/tests"]));
    for (page, least) in [("formats.md", 25), ("calibration-files.md", 13)] {
        let text = read(&repository(), &format!("book/src/reference/{page}")).text;
        let mut count = 0;
        for (head, cells) in rows(&text) {
            let Some(column) = head.iter().position(|title| *title == "test") else { continue };
            let name = cells.get(column).copied().unwrap_or_default().trim_matches('`');
            assert!(there.contains(name), "{page}: {}: there is no test `{name}`", cells[0]);
            count += 1;
        }
        assert!(count >= least, "{page}: {count} formats have a test");
    }
}

#[test]
fn each_message_is_one_of_the_programs() {
    let code: String = sources(&["agent-bin/src", "loopbox/src", "sources/src"]).concat();
    // A literal that goes on in the next line is one text.
    let code: String = code.split("\\\n").map(str::trim_start).collect::<Vec<_>>().concat();
    let text = read(&repository(), "book/src/guide/troubleshooting.md").text;
    let messages: Vec<&str> = rows(&text)
        .into_iter()
        .filter(|(head, _)| head[0] == "message")
        .map(|(_, cells)| cells[0].trim_matches('`'))
        .collect();
    for message in &messages {
        assert!(code.contains(message), "troubleshooting.md: nobody says: {message}");
    }
    assert!(messages.len() > 8, "{} messages", messages.len());
}

/// What people copied from the measured results is still there.
#[test]
fn each_figure_was_measured() {
    let root = repository();
    let measured: String = everything()
        .into_iter()
        .filter(|page| page.name.starts_with("bench/results/") || page.name == "docs/lidar-results.md")
        .map(|page| page.text)
        .collect();
    let numbers = |text: &str| -> BTreeSet<String> {
        let parts = text.split(|c: char| !c.is_ascii_digit() && c != '.');
        parts.map(|part| part.trim_matches('.').to_owned()).collect()
    };
    let known = numbers(&measured);
    let mut count = 0;
    for page in ["benchmarks.md", "limits.md"] {
        let text = read(&root, &format!("book/src/{page}")).text;
        for number in numbers(&text).into_iter().filter(|number| number.contains('.')) {
            assert!(
                known.contains(&number),
                "{page}: {number} is on no page of results: take the newest figure"
            );
            count += 1;
        }
    }
    assert!(count > 20, "{count} figures");
}

/// Fields that a file's structures write, by their names in JSON.
fn fields(code: &str) -> BTreeSet<String> {
    let code = code.split("#[cfg(test)]").next().unwrap_or_default();
    let (mut found, mut is_written, mut renamed) = (BTreeSet::new(), false, None);
    for line in code.lines() {
        match line {
            "}" => is_written = false,
            line if line.starts_with("#[derive") => is_written = line.contains("Serialize"),
            line if line.starts_with("    #[serde(rename = \"") => renamed = line.split('"').nth(1),
            line if is_written && line.starts_with("    pub ") => {
                let name = line.trim_start().trim_start_matches("pub ").split_once(": ");
                let name = renamed.take().or(name.map(|(name, _)| name.trim_start_matches("r#")));
                found.extend(name.map(str::to_owned));
            }
            _ => {}
        }
    }
    found
}

/// A section of the page of JSON.
fn section(heading: &str) -> String {
    let page = read(&repository(), "book/src/reference/json.md").text;
    let (_, section) = page.split_once(&format!("\n## {heading}\n")).expect(heading);
    section.split("\n## ").next().expect("a part").to_owned()
}

#[test]
fn each_field_of_a_record_is_in_its_section() {
    for (heading, files, least) in [
        ("`merge.json` of LiDARs", &["loopbox/src/lidar/merging/record.rs"][..], 35),
        (
            "`manifest.json`",
            &["loopbox/src/common_map/manifest.rs", "merge/src/common_map/arrangement.rs"],
            17,
        ),
        (
            "`fleet.json`, `loopbox fleet --json`",
            &["loopbox/src/fleet/status.rs", "fleet/src/merge_results.rs"],
            30,
        ),
    ] {
        let section = section(heading);
        let fields: BTreeSet<String> =
            files.iter().flat_map(|name| fields(&read(&repository(), name).text)).collect();
        for name in &fields {
            assert!(section.contains(&format!("`{name}`")), "json.md, {heading}: nothing of `{name}`");
        }
        assert!(fields.len() >= least, "{heading}: {} fields", fields.len());
    }
}

#[test]
fn each_event_is_documented() {
    let section = section("Events, `loopbox run --log json`");
    let code = sources(&["agent-bin/src"]).concat();
    // The program's own, and those of notices, which have a name of their own first.
    let written = code.split("\"event\": \"").skip(1);
    let noticed =
        code.split("Notice::").filter_map(|rest| rest.split_once("(_) => \"")).map(|(_, rest)| rest);
    let events: BTreeSet<&str> = written.chain(noticed).filter_map(|rest| rest.split('"').next()).collect();
    for event in &events {
        assert!(section.contains(&format!("`{event}`")), "json.md says nothing of the event {event}");
    }
    assert!(events.len() >= 9, "{events:?}");
}
