//! What keeps the arm from performing a motion, as far as that is known without simulating it.

use powderline_simulator::{
    arm::arm_motion,
    scene::Scene,
    skill::{QuantisedControls, SkillMap, Splines, Theta, collision},
};

/// Why a skill, with what is added to its motion, is no plan: the limits that it breaks, walls in the tool's way, or that the scene's arm cannot make it. Nothing if it is
/// one.
pub(crate) fn obstacle(
    scene: &Scene,
    map: &SkillMap,
    theta: &Theta,
    splines: Option<&Splines>,
) -> Option<String> {
    let quantised = match map.motion(theta, splines).and_then(|controls| {
        let quantised = QuantisedControls::new(&controls)?;
        map.check_limits(&quantised)?;
        Ok(quantised)
    }) {
        Ok(quantised) => quantised,
        Err(error) => return Some(error.to_string()),
    };
    let unable = || {
        let label = scene.arm.as_ref()?.kind.label();
        let refusal = arm_motion(scene, map, &quantised).err()?;
        Some(format!("the {label} cannot make the motion: {refusal}"))
    };
    let collision = collision(scene, map.start_pose(), &quantised.controls);
    collision.map(|collision| collision.to_string()).or_else(unable)
}
