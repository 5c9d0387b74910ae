//! The merging methods by their names on the command line.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use merge::method::Method;
use slam_lidar::merging::MergeMethod;

/// A method for maps of one kind of sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AnyMethod {
    /// For cameras.
    Camera(Method),
    /// For LiDARs.
    Lidar(MergeMethod),
}

/// Takes the name of a method; help and errors list them all.
pub fn method_parser() -> impl TypedValueParser<Value = AnyMethod> {
    let names = Method::ALL.map(Method::name).into_iter().chain(MergeMethod::ALL.map(MergeMethod::name));
    PossibleValuesParser::new(names).try_map(|name| {
        let of_lidar = MergeMethod::ALL.into_iter().find(|method| method.name() == name);
        of_lidar.map_or_else(|| name.parse().map(AnyMethod::Camera), |method| Ok(AnyMethod::Lidar(method)))
    })
}
