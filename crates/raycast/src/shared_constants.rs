//! Constants of the shading that casters on other hardware also need.
//!
//! [`shared_constants!`] defines the constants of a module and lists them, so that a shader gets the numbers of this crate
//! and no copy of them.

/// Value of a constant that the casters of this crate share with the shaders of the GPU.
#[derive(Debug, Clone, PartialEq)]
pub enum SharedValue {
    /// Number with a fraction.
    Float(f32),
    /// Integer of 0 or more.
    Unsigned(u32),
    /// Integer that may be negative.
    Signed(i32),
    /// Vector of two or three numbers.
    Vector(Vec<f32>),
    /// Vector of two or three integers.
    SignedVector(Vec<i32>),
    /// Rows of two or three numbers.
    Rows(Vec<Vec<f32>>),
}

/// Name in the shaders, and value, of a constant of the shading.
pub type SharedConstant = (&'static str, SharedValue);

/// Conversion of a constant to a [`SharedValue`].
pub(crate) trait Share {
    fn share(self) -> SharedValue;
}

impl Share for f32 {
    fn share(self) -> SharedValue {
        SharedValue::Float(self)
    }
}

impl Share for u32 {
    fn share(self) -> SharedValue {
        SharedValue::Unsigned(self)
    }
}

impl Share for usize {
    fn share(self) -> SharedValue {
        SharedValue::Unsigned(self as u32)
    }
}

impl Share for i32 {
    fn share(self) -> SharedValue {
        SharedValue::Signed(self)
    }
}

impl<const N: usize> Share for [f32; N] {
    fn share(self) -> SharedValue {
        SharedValue::Vector(self.to_vec())
    }
}

impl<const N: usize> Share for [i32; N] {
    fn share(self) -> SharedValue {
        SharedValue::SignedVector(self.to_vec())
    }
}

impl Share for f64 {
    fn share(self) -> SharedValue {
        SharedValue::Float(self as f32)
    }
}

impl<const N: usize, const M: usize> Share for [[f64; N]; M] {
    fn share(self) -> SharedValue {
        self.map(|row| row.map(|v| v as f32)).share()
    }
}

impl<const N: usize, const M: usize> Share for [[f32; N]; M] {
    fn share(self) -> SharedValue {
        SharedValue::Rows(self.iter().map(|row| row.to_vec()).collect())
    }
}

/// Define constants of a module, and a function that lists them for shaders.
macro_rules! shared_constants {
    ($($(#[$doc:meta])* $access:vis const $name:ident: $kind:ty = $value:expr;)*) => {
        $($(#[$doc])* $access const $name: $kind = $value;)*

        /// Return names and values of the shared constants of this module.
        pub(crate) fn shared() -> Vec<$crate::shared_constants::SharedConstant> {
            vec![$((stringify!($name), $crate::shared_constants::Share::share($name))),*]
        }
    };
}
pub(crate) use shared_constants;
