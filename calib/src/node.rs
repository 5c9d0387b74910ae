//! A place in a YAML file that knows its file and its path, for messages that help.

use crate::CalibError;
use saphyr::{LoadableYamlNode, Scalar, Yaml};

/// A YAML document with the name of its file.
pub(crate) struct Document<'a> {
    file: &'a str,
    root: Yaml<'a>,
}

impl<'a> Document<'a> {
    /// Parses the first document of a text.
    pub(crate) fn parse(file: &'a str, text: &'a str) -> Result<Self, CalibError> {
        let syntax = |message: String| CalibError::Syntax { file: file.into(), message };
        let documents = Yaml::load_from_str(text).map_err(|error| syntax(error.to_string()))?;
        let root = documents.into_iter().next().ok_or(CalibError::UnknownForm { file: file.into() })?;
        Ok(Self { file, root })
    }

    /// The outermost value.
    pub(crate) fn root(&self) -> Node<'_> {
        Node { file: self.file, path: String::new(), yaml: &self.root }
    }
}

/// One value of a document.
#[derive(Clone)]
pub(crate) struct Node<'a> {
    pub(crate) file: &'a str,
    /// Path from the root, as `cam0.intrinsics[2]`.
    pub(crate) path: String,
    yaml: &'a Yaml<'a>,
}

impl<'a> Node<'a> {
    /// The value of the first of these keys that is there (and not null).
    pub(crate) fn child(&self, names: &[&str]) -> Option<Node<'a>> {
        let yaml = names.iter().find_map(|name| {
            let value = untagged(self.yaml).as_mapping_get(name)?;
            (!value.is_null()).then_some((name, value))
        });
        yaml.map(|(name, yaml)| Node { file: self.file, path: self.path_of(name), yaml })
    }

    /// As [`child`](Self::child), but the key must be there.
    pub(crate) fn need(&self, names: &[&str], fix: &str) -> Result<Node<'a>, CalibError> {
        self.child(names).ok_or_else(|| CalibError::MissingKey {
            file: self.file.into(),
            key: self.path_of(names[0]),
            fix: fix.into(),
        })
    }

    /// Path of a key of this mapping.
    pub(crate) fn path_of(&self, name: &str) -> String {
        if self.path.is_empty() { name.into() } else { format!("{}.{name}", self.path) }
    }

    /// The values of a sequence; none of anything else.
    pub(crate) fn items(&self) -> Vec<Node<'a>> {
        let items = untagged(self.yaml).as_vec().map_or(&[][..], Vec::as_slice);
        let item = |(index, yaml)| Node { file: self.file, path: format!("{}[{index}]", self.path), yaml };
        items.iter().enumerate().map(item).collect()
    }

    /// Whether this is a mapping.
    pub(crate) fn is_mapping(&self) -> bool {
        untagged(self.yaml).is_mapping()
    }

    /// A finite number.
    pub(crate) fn number(&self) -> Result<f64, CalibError> {
        let value = match untagged(self.yaml) {
            Yaml::Value(Scalar::Integer(value)) => Some(*value as f64),
            Yaml::Value(Scalar::FloatingPoint(value)) => Some(value.into_inner()),
            Yaml::Value(Scalar::String(text)) => number_of(text),
            _ => None,
        };
        match value {
            Some(value) if value.is_finite() => Ok(value),
            Some(value) => {
                Err(self
                    .bad(format!("{value} is not a finite number"), "calibrate again, or correct the number"))
            }
            None => Err(self.bad(format!("{} is not a number", self.display_text()), "give one number")),
        }
    }

    /// A whole number of pixels.
    pub(crate) fn pixels(&self) -> Result<usize, CalibError> {
        let value = self.number()?;
        // Image sides above this are mistakes, and would overflow tables.
        if value.fract() == 0.0 && (1.0..=65535.0).contains(&value) {
            return Ok(value as usize);
        }
        Err(self
            .bad(format!("{value} is no image size"), "give the size of the recording's images in pixels"))
    }

    /// A text.
    pub(crate) fn text(&self) -> Result<&'a str, CalibError> {
        untagged(self.yaml)
            .as_str()
            .ok_or_else(|| self.bad(format!("{} is not a name", self.display_text()), "give a name"))
    }

    /// Whether this is the word or number for yes.
    pub(crate) fn is_true(&self) -> bool {
        match untagged(self.yaml) {
            Yaml::Value(Scalar::Boolean(value)) => *value,
            _ => self.number().is_ok_and(|value| value != 0.0),
        }
    }

    /// Finite numbers: a sequence, or a matrix with its numbers under `data`; rows may be nested.
    pub(crate) fn numbers(&self) -> Result<Vec<f64>, CalibError> {
        if let Some(data) = self.child(&["data"]) {
            return data.numbers();
        }
        let Some(items) = untagged(self.yaml).as_vec() else {
            return Err(
                self.bad(format!("{} is not a list of numbers", self.display_text()), "give [a, b, ...]")
            );
        };
        let mut numbers = Vec::with_capacity(items.len());
        for (index, yaml) in items.iter().enumerate() {
            let item = Node { file: self.file, path: format!("{}[{index}]", self.path), yaml };
            match untagged(yaml) {
                Yaml::Sequence(_) => numbers.extend(item.numbers()?),
                _ => numbers.push(item.number()?),
            }
        }
        Ok(numbers)
    }

    /// Exactly `N` finite numbers.
    pub(crate) fn exactly<const N: usize>(&self, fix: &str) -> Result<[f64; N], CalibError> {
        let numbers = self.numbers()?;
        let count = numbers.len();
        numbers.try_into().map_err(|_| self.bad(format!("{count} numbers where {N} belong"), fix))
    }

    /// Two whole numbers of pixels.
    pub(crate) fn size(&self) -> Result<(usize, usize), CalibError> {
        let fix = "give [width, height] of the recording's images in pixels";
        let [width, height] = self.exactly(fix)?;
        let whole = |value: f64| value.fract() == 0.0 && (1.0..=65535.0).contains(&value);
        if whole(width) && whole(height) {
            return Ok((width as usize, height as usize));
        }
        Err(self.bad(format!("{width} × {height} is no image size"), fix))
    }

    /// An error about this value.
    pub(crate) fn bad(&self, problem: String, fix: &str) -> CalibError {
        CalibError::BadValue { file: self.file.into(), key: self.path.clone(), problem, fix: fix.into() }
    }

    /// The value as it may be shown in a message.
    fn display_text(&self) -> String {
        match untagged(self.yaml) {
            Yaml::Value(Scalar::String(text)) => format!("\"{text}\""),
            Yaml::Value(Scalar::Boolean(value)) => value.to_string(),
            Yaml::Value(Scalar::Integer(value)) => value.to_string(),
            Yaml::Value(Scalar::FloatingPoint(value)) => value.to_string(),
            Yaml::Sequence(_) => "a list".into(),
            Yaml::Mapping(_) => "a group of keys".into(),
            _ => "nothing".into(),
        }
    }
}

/// A number as any of the writers puts it; YAML proper knows `.nan`, others write `nan`.
fn number_of(text: &str) -> Option<f64> {
    let text = text.trim();
    match text.to_ascii_lowercase().as_str() {
        ".nan" | "-.nan" => Some(f64::NAN),
        ".inf" | "+.inf" => Some(f64::INFINITY),
        "-.inf" => Some(f64::NEG_INFINITY),
        _ => text.parse().ok(),
    }
}

/// The value under its tags (OpenCV marks matrices `!!opencv-matrix`).
fn untagged<'a>(yaml: &'a Yaml<'a>) -> &'a Yaml<'a> {
    match yaml {
        Yaml::Tagged(_, inner) => untagged(inner),
        other => other,
    }
}
