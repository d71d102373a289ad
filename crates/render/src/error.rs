//! What can go wrong with a graphics device. None of it is fatal to the program: the commands need no device.

use thiserror::Error;

/// Why there is no picture.
#[derive(Clone, Debug, Error)]
pub enum RenderError {
    /// There is no adapter, or it gives no device.
    #[error(
        "no graphics adapter can be used ({reason}); install a Vulkan driver (Mesa's software driver will do), or use `rekindle solve` and \
         `rekindle render`, which need none"
    )]
    NoAdapter {
        /// What the graphics library says.
        reason: String,
    },
    /// The object or the picture is too large for the device.
    #[error(
        "{what} needs {needed}, but the graphics device allows {allowed}; use `rekindle render`, which has no such limit, or {advice}"
    )]
    Limit {
        /// What is too large.
        what: String,
        /// Its size.
        needed: u64,
        /// The device's limit.
        allowed: u64,
        /// What makes it smaller.
        advice: &'static str,
    },
    /// A shader or a pipeline is refused.
    #[error("the graphics driver refuses the shader {name}: {reason}")]
    Shader {
        /// File name of the shader.
        name: &'static str,
        /// What the driver or the validator says.
        reason: String,
    },
    /// The device has run out of memory.
    #[error(
        "the graphics device has no memory left for {what}; close other programs, or make the window smaller"
    )]
    OutOfMemory {
        /// What was to be stored.
        what: String,
    },
    /// The device is gone: a driver was reset or updated, or an external one unplugged.
    #[error(
        "the graphics device was lost ({reason}); the lighting is kept, restart the program to go on"
    )]
    DeviceLost {
        /// What the driver says.
        reason: String,
    },
    /// The driver refuses a command.
    #[error("the graphics device refuses {what}: {reason}")]
    Refused {
        /// What was being done.
        what: String,
        /// What the validator says.
        reason: String,
    },
    /// There is nothing to draw yet.
    #[error("nothing was given to draw; set a surface first")]
    NoSurface,
}
