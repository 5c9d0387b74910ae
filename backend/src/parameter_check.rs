//! Whether parameters have values that can be worked with.

use crate::{DocumentedParameter, Parameter, ParameterValue};
use thiserror::Error;

/// A parameter with a value that cannot be worked with.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("parameter {name} = {value}: it must be {expected}")]
pub struct ParameterError {
    /// Its path in a parameter file, as in `track.cell`.
    pub name: String,
    /// The value given.
    pub value: String,
    /// What can be worked with.
    pub expected: String,
}

/// Checks every number among the parameters: it lies in the range that its documentation states as `Range a–b`; one
/// without is finite, not negative, and at least one if it is a count or size whose default is not zero. Defaults are
/// always right.
///
/// # Errors
/// Names the first parameter with another value.
pub fn check_parameters<P: Parameter + Default>(params: &P) -> Result<(), ParameterError> {
    match params.value() {
        ParameterValue::Table(fields) => check_table("", &fields, &P::documented()),
        ParameterValue::Plain(_) => Ok(()),
    }
}

fn check_table(
    path: &str,
    fields: &[DocumentedParameter],
    defaults: &[DocumentedParameter],
) -> Result<(), ParameterError> {
    for (field, default) in fields.iter().zip(defaults) {
        let name = if path.is_empty() { field.name.to_owned() } else { format!("{path}.{}", field.name) };
        match (&field.default, &default.default) {
            (ParameterValue::Table(fields), ParameterValue::Table(defaults)) => {
                check_table(&name, fields, defaults)?;
            }
            (ParameterValue::Plain(value), ParameterValue::Plain(default)) if value != default => {
                check_value(&name, value, default, &field.doc)?;
            }
            _ => {}
        }
    }
    Ok(())
}

fn check_value(name: &str, value: &str, default: &str, doc: &[&str]) -> Result<(), ParameterError> {
    let Ok(number) = value.parse::<f64>() else { return Ok(()) };
    let is_count = !default.contains('.') && default != "0";
    let (least, most) = stated_range(&doc.concat()).unwrap_or((if is_count { 1.0 } else { 0.0 }, f64::MAX));
    if number >= least && number <= most {
        return Ok(());
    }
    let expected = match most {
        f64::MAX => format!("a number of at least {least}"),
        _ => format!("in the range {least} to {most}"),
    };
    Err(ParameterError { name: name.to_owned(), value: value.to_owned(), expected })
}

/// The numbers of the first `Range a–b` in the documentation of a parameter.
pub fn stated_range(text: &str) -> Option<(f64, f64)> {
    let (least, rest) = text.split_once("Range ")?.1.split_once('–')?;
    let end = rest.find(|c: char| !c.is_ascii_digit() && !".e-".contains(c)).unwrap_or(rest.len());
    Some((least.trim().parse().ok()?, rest[..end].trim_end_matches('.').parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params;

    params! {
        /// Inner.
        pub struct Inner {
            /// A share. Range 0.5–1.
            pub share: f32 = 0.0,
            /// A count; how it is counted
            /// matters. Range 2–20; fewer are faster.
            pub count: usize = 7,
        }
    }
    params! {
        /// Outer.
        pub struct Outer {
            /// A size.
            pub size: usize = 3,
            /// A length.
            pub length: f64 = 1.0,
            /// None is fine.
            pub extra: u32 = 0,
            /// On or off.
            pub enabled: bool = true,
            /// The inner table.
            pub inner: Inner = Inner::default(),
        }
    }

    fn refused(change: impl Fn(&mut Outer)) -> Option<String> {
        let mut params = Outer::default();
        change(&mut params);
        check_parameters(&params).err().map(|error| error.to_string())
    }

    #[test]
    fn what_cannot_be_worked_with_is_named() {
        assert_eq!(refused(|_| ()), None);
        assert_eq!(refused(|p| (p.size, p.extra, p.enabled, p.length) = (1, 5, false, 0.0)), None);
        let error = refused(|p| p.size = 0).unwrap();
        assert_eq!(error, "parameter size = 0: it must be a number of at least 1");
        assert!(
            refused(|p| p.length = f64::NAN).is_some() && refused(|p| p.length = f64::INFINITY).is_some()
        );
        assert!(refused(|p| p.length = -1.0).is_some());
        assert_eq!(refused(|p| p.inner.share = 0.5), None);
        let error = refused(|p| p.inner.share = 1.5).unwrap();
        assert_eq!(error, "parameter inner.share = 1.5: it must be in the range 0.5 to 1");
        assert_eq!(refused(|p| p.inner.count = 20), None);
        assert!(refused(|p| p.inner.count = 21).is_some());
    }
}
