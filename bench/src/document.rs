//! Documents of which parts are measured: what people wrote around the markers stays.

use anyhow::{Context, Result, bail};
use std::path::Path;

/// Replaces, for each `(name, text)`, what stands between the lines `<!-- bench:NAME -->` and
/// `<!-- /bench:NAME -->`; a section without markers in the document is left out.
///
/// # Errors
/// When the document cannot be read or written, or an opening marker has no closing one.
pub fn update(path: &Path, sections: &[(&str, String)]) -> Result<()> {
    let old = std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let mut new = old.clone();
    for (name, text) in sections {
        new = replaced(&new, name, text).with_context(|| path.display().to_string())?;
    }
    if new != old {
        std::fs::write(path, new).with_context(|| format!("{}: cannot be written", path.display()))?;
    }
    Ok(())
}

/// That documents can be read, said before hours are measured.
///
/// # Errors
/// When one cannot be.
pub fn check(paths: &[impl AsRef<Path>]) -> Result<()> {
    paths.iter().try_for_each(|path| update(path.as_ref(), &[]))
}

fn replaced(document: &str, name: &str, text: &str) -> Result<String> {
    let (open, close) = (format!("<!-- bench:{name} -->"), format!("<!-- /bench:{name} -->"));
    let Some((before, rest)) = document.split_once(&open) else { return Ok(document.to_owned()) };
    let Some((_, after)) = rest.split_once(&close) else {
        bail!("the marker `{open}` has no `{close}` after it");
    };
    Ok(format!("{before}{open}\n{}\n{close}{after}", text.trim()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_document_that_is_not_there_is_named() {
        let error = check(&["/there/is/none.md"]).unwrap_err();
        assert!(error.to_string().contains("/there/is/none.md"), "{error}");
    }

    #[test]
    fn only_what_lies_between_the_markers_changes() {
        let document = "# Title\n<!-- bench:a -->\nold\n<!-- /bench:a -->\nwritten by hand\n";
        let once = replaced(document, "a", "new\n").unwrap();
        assert_eq!(once, "# Title\n<!-- bench:a -->\nnew\n<!-- /bench:a -->\nwritten by hand\n");
        assert_eq!(replaced(&once, "a", "new\n").unwrap(), once);
        assert_eq!(replaced(document, "b", "new").unwrap(), document);
        assert!(replaced("<!-- bench:a -->", "a", "new").is_err());
    }
}
