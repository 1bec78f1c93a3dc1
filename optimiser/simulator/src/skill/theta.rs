//! A skill in five numbers, and what a loss changes by with each.

use powderline_shared::plan::SkillParameter;
use serde::{Deserialize, Serialize};
use std::{fmt, ops::Index};
use thiserror::Error;

/// Normalised skill parameters: depth, scoop angle, lift, transport, pour angle, each in `[-1, 1]`. There is none outside: whoever has
/// one need not look.
///
/// ```
/// use powderline_simulator::skill::{SkillParameter, Theta, ThetaError};
///
/// let theta = Theta::new([0.3, 0.0, 0.0, 0.0, 0.3])?;
/// assert_eq!(theta[SkillParameter::PouringAngle], 0.3);
/// // A search that goes too far comes to the end of the range.
/// let deepest = theta.moved(SkillParameter::ScoopingDepth, 5.0);
/// assert_eq!(deepest.components(), [1.0, 0.0, 0.0, 0.0, 0.3]);
///
/// let error = Theta::new([0.0, 0.0, 0.0, 1.5, 0.0]).unwrap_err();
/// assert_eq!(error.to_string(), "theta's component 3 (transport displacement) is 1.5, outside [-1, 1]");
/// # Ok::<_, ThetaError>(())
/// ```
///
/// Five numbers are no theta before they are looked at:
///
/// ```compile_fail
/// use powderline_simulator::{scene::Scene, skill::SkillMap};
///
/// let map = SkillMap::new(&Scene::load("bench-small").unwrap());
/// map.controls(&[0.3, 0.0, 0.0, 0.0, 0.3]);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "[f64; 5]", into = "[f64; 5]")]
pub struct Theta([f64; 5]);

/// Derivative of the loss with respect to each component of [`Theta`], metres per unit of it: five numbers of any size, to calculate with.
pub type ThetaGradient = [f64; 5];

/// A component of theta that is outside `[-1, 1]`, or not a number.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error("theta's component {} ({}) is {value}, outside [-1, 1]", parameter.index(), parameter.name())]
#[non_exhaustive]
pub struct ThetaError {
    /// Which component.
    pub parameter: SkillParameter,
    /// Its value.
    pub value: f64,
}

impl Theta {
    /// The middle of all ranges; the default.
    pub const MIDDLE: Self = Self([0.0; 5]);

    /// The skill of five numbers, in the order of [`SkillParameter::ALL`].
    ///
    /// # Errors
    /// The first component outside `[-1, 1]`, or not a number.
    pub fn new(components: [f64; 5]) -> Result<Self, ThetaError> {
        let mut named = SkillParameter::ALL.into_iter().zip(components);
        match named.find(|(_, value)| !(-1.0..=1.0).contains(value)) {
            Some((parameter, value)) => Err(ThetaError { parameter, value }),
            None => Ok(Self(components)),
        }
    }

    /// The nearest skill; in the middle where a component is not a number.
    #[must_use]
    pub fn clamped(components: [f64; 5]) -> Self {
        Self(components.map(|value| if value.is_nan() { 0.0 } else { value.clamp(-1.0, 1.0) }))
    }

    /// The five numbers, in the order of [`SkillParameter::ALL`].
    #[must_use]
    pub const fn components(&self) -> [f64; 5] {
        self.0
    }

    /// The same with another value of one component.
    ///
    /// # Errors
    /// The value is outside `[-1, 1]`, or not a number.
    pub fn with(mut self, parameter: SkillParameter, value: f64) -> Result<Self, ThetaError> {
        self.0[parameter.index()] = value;
        Self::new(self.0)
    }

    /// The same with one component moved, as far as its range goes; not at all by what is not a number.
    #[must_use]
    pub const fn moved(mut self, parameter: SkillParameter, by: f64) -> Self {
        let component = &mut self.0[parameter.index()];
        if !by.is_nan() {
            *component = (*component + by).clamp(-1.0, 1.0);
        }
        self
    }

    /// Every skill whose components are among so many values that fill the range evenly, its ends among them. The first component
    /// runs fastest.
    pub(crate) fn lattice(values: usize) -> impl Iterator<Item = Self> {
        let value = move |index: usize| 2.0 * (index as f64) / (values - 1) as f64 - 1.0;
        let component = move |index: usize, k: usize| value(index / values.pow(k as u32) % values);
        (0..values.pow(5)).map(move |index| Self(std::array::from_fn(|k| component(index, k))))
    }
}

impl TryFrom<[f64; 5]> for Theta {
    type Error = ThetaError;

    fn try_from(components: [f64; 5]) -> Result<Self, ThetaError> {
        Self::new(components)
    }
}

impl From<Theta> for [f64; 5] {
    fn from(theta: Theta) -> Self {
        theta.0
    }
}

impl Index<SkillParameter> for Theta {
    type Output = f64;

    fn index(&self, parameter: SkillParameter) -> &f64 {
        &self.0[parameter.index()]
    }
}

impl fmt::Display for Theta {
    /// As a list, `[0.3, 0.0, 0.0, 0.0, 0.3]`; width and precision are those of each number.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(&self.0, f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_outside_the_range_is_refused_by_name() {
        for value in
            [1.000_000_1, -1.000_000_1, 1.0 + f64::EPSILON, f64::NAN, f64::INFINITY, f64::NEG_INFINITY]
        {
            let components = [0.0, 0.0, 0.0, value, f64::NAN];
            let error = Theta::new(components).unwrap_err();
            let words = format!("theta's component 3 (transport displacement) is {value}, outside [-1, 1]");
            assert_eq!(error.to_string(), words);
            assert!(Theta::try_from(components).is_err());
            assert!(Theta::MIDDLE.with(SkillParameter::LiftHeight, value).is_err());
        }
    }

    #[test]
    fn the_ends_of_the_range_are_within_it() {
        let ends = [-1.0, 1.0, -0.0, f64::MIN_POSITIVE, 1.0 - f64::EPSILON];
        let theta = Theta::new(ends).unwrap();
        assert_eq!(theta.components().map(f64::to_bits), ends.map(f64::to_bits));
        assert_eq!(<[f64; 5]>::from(theta).map(f64::to_bits), ends.map(f64::to_bits));
        assert_eq!(SkillParameter::ALL.map(|which| theta[which].to_bits()), ends.map(f64::to_bits));
    }

    #[test]
    fn what_is_moved_or_clamped_stays_in_the_range() {
        let theta = Theta::new([0.3, -0.9, 0.0, 1.0, -1.0]).unwrap();
        let moved = |parameter: SkillParameter, by: f64| theta.moved(parameter, by)[parameter].to_bits();
        assert_eq!(moved(SkillParameter::ScoopingDepth, 0.1), (0.3f64 + 0.1).to_bits());
        assert_eq!(moved(SkillParameter::ScoopingAngle, -0.2), (-1.0f64).to_bits());
        assert_eq!(moved(SkillParameter::TransportDisplacement, f64::INFINITY), 1.0f64.to_bits());
        assert_eq!(theta.moved(SkillParameter::LiftHeight, f64::NAN), theta);
        let clamped = Theta::clamped([f64::NAN, f64::INFINITY, -1.5, 0.3, -1.0]);
        assert_eq!(clamped, Theta::new([0.0, 1.0, -1.0, 0.3, -1.0]).unwrap());
        assert_eq!(theta.with(SkillParameter::LiftHeight, -1.0), Theta::new([0.3, -0.9, -1.0, 1.0, -1.0]));
    }

    #[test]
    fn a_lattice_holds_ends_and_middles() {
        let corners: Vec<Theta> = Theta::lattice(2).collect();
        assert_eq!((corners.len(), corners[0]), (32, Theta::clamped([-1.0; 5])));
        assert_eq!(corners[9], Theta::new([1.0, -1.0, -1.0, 1.0, -1.0]).unwrap());
        let thirds: Vec<Theta> = Theta::lattice(3).collect();
        assert_eq!((thirds.len(), thirds[121]), (243, Theta::MIDDLE));
        assert_eq!(thirds[1], Theta::new([0.0, -1.0, -1.0, -1.0, -1.0]).unwrap());
    }

    #[test]
    fn files_hold_five_numbers_and_are_looked_at() {
        let components = [0.1, -0.2, 1.0 / 3.0, 0.0, -1.0];
        let theta = Theta::new(components).unwrap();
        let text = serde_json::to_string(&theta).unwrap();
        assert_eq!(text, serde_json::to_string(&components).unwrap());
        assert_eq!(serde_json::from_str::<Theta>(&text).unwrap(), theta);
        let error = serde_json::from_str::<Theta>("[0.0, 1.5, 0.0, 0.0, 0.0]").unwrap_err().to_string();
        assert!(error.contains("theta's component 1 (scooping angle) is 1.5, outside [-1, 1]"), "{error}");
        assert!(serde_json::from_str::<Theta>("[0.0, 0.5, 0.0, 0.0]").is_err());
        let bytes = |components: &[f64; 5]| postcard::to_allocvec(components).unwrap();
        assert_eq!(postcard::to_allocvec(&theta).unwrap(), bytes(&components));
        assert_eq!(postcard::from_bytes::<Theta>(&bytes(&components)), Ok(theta));
        assert!(postcard::from_bytes::<Theta>(&bytes(&[0.0, 0.0, 0.0, 0.0, f64::NAN])).is_err());
    }

    #[test]
    fn shown_as_its_numbers_are() {
        let components = [0.3, 0.0, -1.0, 0.125, 1.0];
        let theta = Theta::new(components).unwrap();
        assert_eq!(theta.to_string(), format!("{components:?}"));
        assert_eq!(format!("{theta:5.1}"), format!("{components:5.1?}"));
    }
}
