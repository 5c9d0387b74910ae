//! Scripts of pages: modules as files, made one script of a page without a network.
//!
//! Each file is an ECMAScript module that names what it takes of others, so that editors, type checkers and tests read it as
//! it is. A page that is opened from a disk may load no modules, so they are linked here: import lines and the word `export`
//! go, what is left stands in one function in the order in which it is given. That is all that modules mean as long as no
//! name is taken twice and nobody is imported before its turn, and both are checked. Comments on lines of their own are left
//! out.

use anyhow::{Result, bail, ensure};
use std::collections::{BTreeMap, BTreeSet};

/// A module.
#[derive(Clone, Copy, Debug)]
pub struct Script {
    /// Its file; imports are told apart by its last part.
    pub path: &'static str,
    /// What it says.
    pub source: &'static str,
}

/// The [`Script`] of a file, by its path relative to where this is written.
#[macro_export]
macro_rules! script {
    ($path:literal) => {
        $crate::report::script::Script { path: $path, source: include_str!($path) }
    };
}

impl Script {
    /// The file's name.
    fn name(&self) -> &'static str {
        self.path.rsplit('/').next().unwrap_or(self.path)
    }
}

/// Some modules as one script.
///
/// # Errors
/// When one imports what does not come before it, or by another form than `import { a, b } from "./c.js";` on a line of its
/// own, exports by another form than `export` before what it declares, or declares a name that another has declared.
pub fn link<'a>(scripts: impl IntoIterator<Item = &'a Script>) -> Result<String> {
    let mut out = String::new();
    let mut exports: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    let mut declared: BTreeMap<&str, &str> = BTreeMap::new();
    for script in scripts {
        let name = script.name();
        let mut own = BTreeSet::new();
        let mut in_comment = false;
        for line in script.source.lines() {
            let begun = line.trim_start();
            if in_comment || begun.starts_with("/*") {
                in_comment = !line.contains("*/");
                continue;
            }
            if begun.is_empty() || begun.starts_with("//") {
                continue;
            }
            if line.starts_with("import") {
                check_import(line, &exports).map_err(|error| error.context(script.path))?;
                continue;
            }
            let exported = line.strip_prefix("export ");
            let line = exported.unwrap_or(line);
            if let Some(of) = declared_by(line) {
                if let Some(other) = declared.insert(of, name) {
                    bail!("{}: {of} is declared by {other} already", script.path);
                }
                if exported.is_some() {
                    own.insert(of);
                }
            } else {
                ensure!(exported.is_none(), "{}: what does this export? {line}", script.path);
            }
            out.push_str(line);
            out.push('\n');
        }
        ensure!(exports.insert(name, own).is_none(), "{}: this module is there already", script.path);
    }
    Ok(out)
}

/// The name that a line declares at the top of a module.
fn declared_by(line: &str) -> Option<&str> {
    let kinds = ["const ", "let ", "class ", "function "];
    let rest = kinds.iter().find_map(|kind| line.strip_prefix(kind))?;
    let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_' && c != '$').unwrap_or(rest.len());
    (end > 0).then(|| &rest[..end])
}

/// Whether what is imported is there.
fn check_import(line: &str, exports: &BTreeMap<&str, BTreeSet<&str>>) -> Result<()> {
    let parts = line.strip_prefix("import { ").and_then(|rest| rest.strip_suffix("\";"));
    let Some((names, path)) = parts.and_then(|rest| rest.split_once(" } from \"")) else {
        bail!("an import of another form: {line}");
    };
    let from = path.rsplit('/').next().unwrap_or(path);
    let Some(there) = exports.get(from) else { bail!("{from} does not come before it") };
    for name in names.split(", ") {
        ensure!(there.contains(name), "{from} does not export {name}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn linked(sources: &[(&'static str, &'static str)]) -> Result<String> {
        let scripts: Vec<Script> = sources.iter().map(|&(path, source)| Script { path, source }).collect();
        link(&scripts)
    }

    #[test]
    fn modules_become_one_script() {
        let a = (
            "x/a.js",
            "// A.\n\nexport const one = 1;\n/**\n * Says {{nothing}}.\n */\nfunction two() {}\nexport class Three {\n  /** @type {x} */\n  four() {}\n}\n",
        );
        let b = (
            "y/b.js",
            "import { Three, one } from \"../x/a.js\";\n\nconst [five] = [one];\nnew Three(five);\n",
        );
        let script = linked(&[a, b]).unwrap();
        assert!(
            !script.contains("import") && !script.contains("export") && !script.contains("/*"),
            "{script}"
        );
        for line in ["const one = 1;", "class Three {", "new Three(five);"] {
            assert!(script.lines().any(|l| l == line), "{line}");
        }
    }

    #[test]
    fn what_a_page_would_stumble_over_is_refused() {
        let a = ("a.js", "export const one = 1;\nconst two = 2;\n");
        let refused = |source, why: &str| {
            let error = linked(&[a, ("b.js", source)]).unwrap_err();
            assert!(format!("{error:#}").contains(why), "{error:#}");
        };
        refused("import { two } from \"./a.js\";\n", "a.js does not export two");
        refused("import { one } from \"./c.js\";\n", "c.js does not come before it");
        refused("import { one as two } from \"./a.js\";\n", "does not export one as two");
        refused("import * as all from \"./a.js\";\n", "another form");
        refused("export default 3;\n", "what does this export?");
        refused("let two = 3;\n", "two is declared by a.js already");
        assert!(linked(&[a, a]).is_err());
        assert!(linked(&[("b.js", "import { one } from \"./a.js\";\n"), a]).is_err());
    }
}
