//! The two floating-point types the simulator runs in, and the elementary functions it needs.
//!
//! Logarithm and exponential are polynomials of our own: the compiler turns them into vector instructions,
//! and they give the same bits on every machine, which the C library's do not.

use core::fmt::{Debug, Display};
use core::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Coefficients of a polynomial, lowest first, by interpolation at Chebyshev's nodes.
#[derive(Clone, Copy, Debug)]
pub struct Polynomial {
    /// How many.
    pub terms: usize,
    /// The coefficients; zeros after the last.
    pub coefficients: [f64; Self::MAX_TERMS],
}

impl Polynomial {
    /// Most terms of a series.
    pub const MAX_TERMS: usize = 26;

    const fn new(coefficients: &[f64]) -> Self {
        let mut all = [0.0; Self::MAX_TERMS];
        let mut k = 0;
        while k < coefficients.len() {
            all[k] = coefficients[k];
            k += 1;
        }
        Self { terms: coefficients.len(), coefficients: all }
    }
}

/// `f32` or `f64`, which the simulator computes in. Not to be implemented elsewhere.
pub trait Real: RealOps {}

impl Real for f32 {}
impl Real for f64 {}

/// What a [`Real`] can do. Every method is branch-free, so that loops over lanes vectorise.
pub trait RealOps:
    Copy
    + Default
    + Debug
    + Display
    + PartialOrd
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// A square that is as good as 0: its root and the reciprocals of both are still numbers.
    const TINY: Self;
    /// `ln(1 + x)/x` for `|x| <= 0.49` by powers of `x`; relative error 5e-9 (`f32`), 7e-17 (`f64`).
    const LN_1P_SERIES: Polynomial;
    /// `(exp(x) - 1)/x` for `|x| <= 0.6` by powers of `x`; relative error 2e-8 (`f32`), 5e-18 (`f64`).
    const EXP_M1_SERIES: Polynomial;
    /// Nearest value of this type.
    fn from_f64(x: f64) -> Self;
    /// The value as `f64`, exact.
    fn to_f64(self) -> f64;
    /// Square root, correctly rounded.
    fn sqrt(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// Nearest integer (ties to even) of a value below 2^22, as a number and as an integer. A cast with `as`
    /// saturates, and the compiler does not vectorise that.
    fn nearest(self) -> (Self, i32);
    /// `ln(1 + x)`, within 2 units in the last place; NaN for `x <= -1`.
    fn ln_1p(self) -> Self;
    /// `exp(x) - 1`, within 3 units in the last place; the argument is held within +-80.
    fn exp_m1(self) -> Self;
    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool;
    /// `self a + b`, rounded once: one instruction where the machine has it, the same bits where it has not.
    fn mul_add(self, a: Self, b: Self) -> Self;
    /// Runs a kernel with the widest instruction set of the machine.
    #[inline(always)]
    fn dispatch<K: pulp::NullaryFnOnce>(arch: pulp::Arch, kernel: K) -> K::Output {
        arch.dispatch(kernel)
    }

    /// The larger of both; NaN if `self` is NaN.
    #[inline(always)]
    fn at_least(self, low: Self) -> Self {
        if self < low { low } else { self }
    }
    /// The smaller of both; NaN if `self` is NaN.
    #[inline(always)]
    fn at_most(self, high: Self) -> Self {
        if self > high { high } else { self }
    }
    /// `self` where `keep`, else 0.
    #[inline(always)]
    fn only_if(self, keep: bool) -> Self {
        if keep { self } else { Self::ZERO }
    }
    /// `[0, 1]`-clamped.
    #[inline(always)]
    fn unit(self) -> Self {
        self.at_least(Self::ZERO).at_most(Self::ONE)
    }
}

impl RealOps for f32 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const TINY: Self = 1e-36;
    const LN_1P_SERIES: Polynomial = Polynomial::new(&[
        1.0,
        -0.499_999_908_1,
        0.333_333_247,
        -0.250_010_640_9,
        0.200_009_993_3,
        -0.166_318_825_3,
        0.142_530_517_6,
        -0.129_793_744_7,
        0.115_611_310_9,
        -0.068_827_711_44,
        0.061_659_531_79,
        -0.173_775_752_8,
        0.161_699_572_4,
    ]);
    const EXP_M1_SERIES: Polynomial = Polynomial::new(&[
        1.0,
        0.500_000_127_5,
        0.166_666_680_8,
        0.041_663_835_82,
        0.008_333_019_167,
        0.001_404_592_249,
        0.000_200_155_929_9,
    ]);

    #[inline(always)]
    fn from_f64(x: f64) -> Self {
        x as f32
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f32::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f32::abs(self)
    }
    #[inline(always)]
    fn nearest(self) -> (Self, i32) {
        // At this size the unit of the last place is 1, and the low bits are the integer.
        const SHIFT: f32 = 12_582_912.0;
        let shifted = self + SHIFT;
        (shifted - SHIFT, (shifted.to_bits() as i32).wrapping_sub(SHIFT.to_bits() as i32))
    }
    /// The reduction of Sun's fdlibm (`s_log1pf.c`), without its branches.
    #[inline(always)]
    fn ln_1p(self) -> Self {
        const SQRT_HALF_BITS: i32 = 0x3f35_04f3;
        let u = 1.0 + self;
        let k = ((u.to_bits() as i32).wrapping_sub(SQRT_HALF_BITS)) >> 23;
        let f = f32::from_bits((u.to_bits() as i32).wrapping_sub(k << 23) as u32) - 1.0;
        // What rounding 1 + x lost, relative to u.
        let lost = if self < 1.0 { self - (u - 1.0) } else { 1.0 - (u - self) };
        let k = k as f32;
        let s = f / (2.0 + f);
        let z = s * s;
        let r = z * (0.666_666_6 + z * (0.400_009_72 + z * (0.284_987_87 + z * 0.242_790_79)));
        let half = 0.5 * f * f;
        let y = (s * (half + r) + (k * 9.058_001e-6 + lost / u) - half) + f + k * 0.693_138_1;
        if u > 0.0 { y } else { f32::NAN }
    }
    #[inline(always)]
    fn exp_m1(self) -> Self {
        let x = self.at_least(-80.0).at_most(80.0);
        let (kf, k) = (x * core::f32::consts::LOG2_E).nearest();
        let r = (x - kf * 0.693_145_75) - kf * 1.428_606_8e-6;
        let p = r
            * (1.0
                + r * (0.5
                    + r * (1.0 / 6.0
                        + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r * (1.0 / 5040.0)))))));
        let scale = f32::from_bits((k.wrapping_add(127) << 23) as u32);
        scale * p + (scale - 1.0)
    }
    #[inline(always)]
    fn is_finite(self) -> bool {
        f32::is_finite(self)
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        f32::mul_add(self, a, b)
    }
}

impl RealOps for f64 {
    const ZERO: Self = 0.0;
    const ONE: Self = 1.0;
    const TINY: Self = 1e-290;
    const LN_1P_SERIES: Polynomial = Polynomial::new(&[
        1.0,
        -0.5,
        0.333_333_333_333_265_54,
        -0.249_999_999_999_934_39,
        0.200_000_000_015_758_85,
        -0.166_666_666_681_921_7,
        0.142_857_141_422_137_85,
        -0.124_999_998_610_890_67,
        0.111_111_178_773_785_97,
        -0.100_000_065_497_379_12,
        0.090_907_199_942_746_62,
        -0.083_331_502_929_274_15,
        0.076_956_823_653_271_78,
        -0.071_461_236_161_024_73,
        0.066_265_877_546_392_83,
        -0.062_112_080_126_164_78,
        0.062_049_834_513_029_624,
        -0.058_678_055_453_478_32,
        0.035_064_769_803_738_1,
        -0.033_000_001_161_179_91,
        0.110_595_054_856_709_06,
        -0.106_390_007_030_935_24,
        -0.095_167_910_708_812_59,
        0.092_455_984_535_699_82,
        0.196_472_179_724_175_22,
        -0.189_755_778_931_704,
    ]);
    const EXP_M1_SERIES: Polynomial = Polynomial::new(&[
        1.0,
        0.499_999_999_999_999_94,
        0.166_666_666_666_666_66,
        0.041_666_666_666_672_86,
        0.008_333_333_333_333_746,
        0.001_388_888_888_751_273,
        0.000_198_412_698_403_529_07,
        2.480_158_861_188_797_2e-05,
        2.755_732_009_706_384_5e-06,
        2.755_671_288_354_668_5e-07,
        2.505_170_434_747_591e-08,
        2.101_136_809_045_062e-09,
        1.614_875_288_744_473_4e-10,
    ]);

    #[inline(always)]
    fn from_f64(x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn abs(self) -> Self {
        f64::abs(self)
    }
    #[inline(always)]
    fn nearest(self) -> (Self, i32) {
        const SHIFT: f64 = 6_755_399_441_055_744.0;
        let shifted = self + SHIFT;
        (shifted - SHIFT, (shifted.to_bits() as i64).wrapping_sub(SHIFT.to_bits() as i64) as i32)
    }
    /// The reduction of Sun's fdlibm (`s_log1p.c`), without its branches.
    #[inline(always)]
    fn ln_1p(self) -> Self {
        const SQRT_HALF_BITS: i64 = 0x3fe6_a09e_667f_3bcd;
        let u = 1.0 + self;
        let k = ((u.to_bits() as i64).wrapping_sub(SQRT_HALF_BITS)) >> 52;
        let f = f64::from_bits((u.to_bits() as i64).wrapping_sub(k << 52) as u64) - 1.0;
        let lost = if self < 1.0 { self - (u - 1.0) } else { 1.0 - (u - self) };
        let k = k as f64;
        let s = f / (2.0 + f);
        let z = s * s;
        let r = z
            * (6.666_666_666_666_735e-1
                + z * (3.999_999_999_940_942e-1
                    + z * (2.857_142_874_366_239e-1
                        + z * (2.222_219_843_214_978_4e-1
                            + z * (1.818_357_216_161_805e-1
                                + z * (1.531_383_769_920_937_3e-1 + z * 1.479_819_860_511_658_6e-1))))));
        let half = 0.5 * f * f;
        let y = (s * (half + r) + (k * 1.908_214_929_270_587_7e-10 + lost / u) - half)
            + f
            + k * 6.931_471_803_691_238e-1;
        if u > 0.0 { y } else { f64::NAN }
    }
    #[inline(always)]
    fn exp_m1(self) -> Self {
        let x = self.at_least(-80.0).at_most(80.0);
        let (kf, k) = (x * core::f64::consts::LOG2_E).nearest();
        let r = (x - kf * 6.931_471_803_691_238e-1) - kf * 1.908_214_929_270_587_7e-10;
        // Taylor series to r^14, |r| <= ln(2)/2: the remainder is below 2e-19.
        const INVERSE_FACTORIAL: [f64; 12] = [
            1.0 / 6.0,
            1.0 / 24.0,
            1.0 / 120.0,
            1.0 / 720.0,
            1.0 / 5_040.0,
            1.0 / 40_320.0,
            1.0 / 362_880.0,
            1.0 / 3_628_800.0,
            1.0 / 39_916_800.0,
            1.0 / 479_001_600.0,
            1.0 / 6_227_020_800.0,
            1.0 / 87_178_291_200.0,
        ];
        let c = &INVERSE_FACTORIAL;
        let high = c[6] + r * (c[7] + r * (c[8] + r * (c[9] + r * (c[10] + r * c[11]))));
        let low = c[0] + r * (c[1] + r * (c[2] + r * (c[3] + r * (c[4] + r * (c[5] + r * high)))));
        let p = r + r * r * (0.5 + r * low);
        let scale = f64::from_bits(((i64::from(k).wrapping_add(1023)) << 52) as u64);
        scale * p + (scale - 1.0)
    }
    #[inline(always)]
    fn is_finite(self) -> bool {
        f64::is_finite(self)
    }
    #[inline(always)]
    fn mul_add(self, a: Self, b: Self) -> Self {
        f64::mul_add(self, a, b)
    }
}

#[cfg(test)]
mod tests {
    use super::RealOps;

    fn samples() -> impl Iterator<Item = f64> {
        let small = (0..4000).map(|i| (f64::from(i) - 2000.0) * 4.9e-4);
        let tiny = (-300..0)
            .flat_map(|e| [10f64.powf(f64::from(e) / 12.0), -(10f64.powf(f64::from(e) / 12.0)) * 0.999]);
        small.chain(tiny).chain([1.5, 3.0, 10.0, 77.0])
    }

    #[test]
    fn logarithm_and_exponential_agree_with_std() {
        for x in samples() {
            if x > -1.0 {
                let want = x.ln_1p();
                assert!((RealOps::ln_1p(x) - want).abs() <= 4.5e-16 * want.abs(), "ln_1p({x})");
                let narrow = x as f32;
                let want = f64::from(narrow).ln_1p();
                assert!(
                    (f64::from(RealOps::ln_1p(narrow)) - want).abs() <= 2.4e-7 * want.abs(),
                    "ln_1p({narrow})"
                );
            }
            let want = x.exp_m1();
            assert!(
                (RealOps::exp_m1(x) - want).abs() <= 7e-16 * want.abs(),
                "exp_m1({x}) {} {want}",
                RealOps::exp_m1(x)
            );
            let narrow = x as f32;
            let want = f64::from(narrow).exp_m1();
            assert!(
                (f64::from(RealOps::exp_m1(narrow)) - want).abs() <= 3.6e-7 * want.abs(),
                "exp_m1({narrow})"
            );
        }
    }

    #[test]
    fn series_are_as_near_as_they_say() {
        let value = |series: &super::Polynomial, x: f64| {
            series.coefficients[..series.terms].iter().rev().fold(0.0, |sum, c| sum * x + c)
        };
        for i in (-1000..=1000).filter(|i| *i != 0) {
            let unit = f64::from(i) / 1000.0;
            let (x, y) = (0.49 * unit, 0.6 * unit);
            let (ln, exp) = (x.ln_1p() / x, y.exp_m1() / y);
            for (narrow, wide) in [
                (value(&f32::LN_1P_SERIES, x) / ln, value(&f64::LN_1P_SERIES, x) / ln),
                (value(&f32::EXP_M1_SERIES, y) / exp, value(&f64::EXP_M1_SERIES, y) / exp),
            ] {
                assert!(
                    (narrow - 1.0).abs() < 1.5e-8 && (wide - 1.0).abs() < 9e-16,
                    "{unit}: {narrow} {wide}"
                );
            }
        }
    }

    #[test]
    fn what_is_not_a_strain_gives_nan() {
        for x in [-1.0, -2.0, f64::NEG_INFINITY, f64::NAN] {
            assert!(RealOps::ln_1p(x).is_nan() && RealOps::ln_1p(x as f32).is_nan());
        }
        assert!(RealOps::exp_m1(f64::NAN).is_nan() && RealOps::exp_m1(f32::NAN).is_nan());
    }
}
