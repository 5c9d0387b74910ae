//! Whether what the program prints for other programs is documented.

use serde_json::Value;

const DOCUMENT: &str = include_str!("../../../book/src/reference/json.md");
/// Fields whose own fields are anybody's.
const OPEN: [&str; 4] = ["params", "provenance", "merge_provenance", "skipped"];

/// Fails unless book/src/reference/json.md names every field of `json`.
pub fn assert_documented(json: &Value) {
    match json {
        Value::Object(fields) => {
            for (name, value) in fields {
                assert!(
                    DOCUMENT.contains(&format!("`{name}`")),
                    "book/src/reference/json.md says nothing of `{name}`"
                );
                if !OPEN.contains(&name.as_str()) {
                    assert_documented(value);
                }
            }
        }
        Value::Array(values) => values.iter().for_each(assert_documented),
        _ => {}
    }
}
