//! The parameters of the skill.

/// A parameter of the skill. Where there are five numbers, [`PlanHeader::theta`](super::PlanHeader::theta) and
/// [`PlanHeader::skill_parameters`](super::PlanHeader::skill_parameters) among them, they stand in the order of [`Self::ALL`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SkillParameter {
    /// How deep the tool goes into the powder.
    ScoopingDepth,
    /// How far it turns while it scoops.
    ScoopingAngle,
    /// How high it is lifted then.
    LiftHeight,
    /// How far it is carried along the heading.
    TransportDisplacement,
    /// How far it is tilted to pour.
    PouringAngle,
}

impl SkillParameter {
    /// All of them, in order.
    pub const ALL: [Self; 5] = [
        Self::ScoopingDepth,
        Self::ScoopingAngle,
        Self::LiftHeight,
        Self::TransportDisplacement,
        Self::PouringAngle,
    ];

    /// Its place in [`Self::ALL`].
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// What it is called.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::ScoopingDepth => "scooping depth",
            Self::ScoopingAngle => "scooping angle",
            Self::LiftHeight => "lift height",
            Self::TransportDisplacement => "transport displacement",
            Self::PouringAngle => "pouring angle",
        }
    }

    /// Key of its range in a scene's `[skill]`.
    #[must_use]
    pub const fn key(self) -> &'static str {
        match self {
            Self::ScoopingDepth => "scooping_depth_m",
            Self::ScoopingAngle => "scooping_angle_deg",
            Self::LiftHeight => "lift_height_m",
            Self::TransportDisplacement => "transport_displacement_m",
            Self::PouringAngle => "pouring_angle_deg",
        }
    }

    /// Whether it is an angle; the others are lengths.
    #[must_use]
    pub const fn is_angle(self) -> bool {
        matches!(self, Self::ScoopingAngle | Self::PouringAngle)
    }

    /// Unit of its value in a plan.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        if self.is_angle() { "rad" } else { "m" }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_and_places_fit_names_and_units() {
        for (index, parameter) in SkillParameter::ALL.into_iter().enumerate() {
            assert_eq!(parameter.index(), index);
            let unit = if parameter.is_angle() { "_deg" } else { "_m" };
            assert_eq!(parameter.key(), parameter.name().replace(' ', "_") + unit);
        }
    }
}
