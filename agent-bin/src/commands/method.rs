//! The merging methods by their names on the command line.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use merge::method::Method;

/// Takes the name of a method; help and errors list them all.
pub fn method_parser() -> impl TypedValueParser<Value = Method> {
    PossibleValuesParser::new(Method::ALL.map(Method::name)).try_map(|name| name.parse::<Method>())
}
