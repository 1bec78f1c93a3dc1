//! One line for machines over semihosting, then the end. Own decimals: those of `core::fmt` can panic.

use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::nr;
use cortex_m_semihosting::syscall1;
use heapless::Vec;

/// A line of `name=value` pairs; what has no room is missing, which its reader sees.
pub struct Report {
    line: Vec<u8, 1024>,
}

impl Report {
    /// A line that begins with a word.
    pub fn new(word: &str) -> Self {
        let mut report = Self { line: Vec::new() };
        report.text(word);
        report
    }

    /// Adds a number.
    pub fn number(&mut self, name: &str, value: u64) -> &mut Self {
        let mut digits = [b'0'; 20];
        let mut rest = value;
        for digit in digits.iter_mut().rev() {
            *digit = b'0'.wrapping_add((rest % 10) as u8);
            rest /= 10;
        }
        self.name(name);
        let mut leading = true;
        for (place, digit) in digits.into_iter().enumerate() {
            leading = leading && digit == b'0' && place != 19;
            if !leading {
                self.byte(digit);
            }
        }
        self
    }

    /// Adds 64 bits in hexadecimal digits.
    pub fn bits(&mut self, name: &str, value: u64) -> &mut Self {
        self.name(name);
        for nibble in 0..16_u32 {
            let digit = (value.rotate_left(nibble.wrapping_mul(4).wrapping_add(4)) & 15) as u8;
            self.byte(if digit < 10 {
                b'0'.wrapping_add(digit)
            } else {
                b'a'.wrapping_add(digit).wrapping_sub(10)
            });
        }
        self
    }

    /// Prints the line and ends the program.
    pub fn succeed(mut self) -> ! {
        self.print();
        debug::exit(EXIT_SUCCESS);
        forever()
    }

    fn print(&mut self) {
        self.byte(b'\n');
        // The host reads up to the zero.
        if self.line.push(0).is_err() {
            self.line.pop();
            self.byte(0);
        }
        // SAFETY: the argument of this call is the address of a text that ends with zero, and the buffer does.
        unsafe { syscall1(nr::WRITE0, self.line.as_ptr().addr()) };
    }

    fn name(&mut self, name: &str) {
        self.byte(b' ');
        self.text(name);
        self.byte(b'=');
    }

    fn text(&mut self, text: &str) {
        text.bytes().for_each(|byte| self.byte(byte));
    }

    fn byte(&mut self, byte: u8) {
        let _ = self.line.push(byte);
    }
}

/// Says what went wrong and ends the program as failed.
pub fn fail(what: &str) -> ! {
    let mut report = Report::new("failed: ");
    report.text(what);
    report.print();
    debug::exit(EXIT_FAILURE);
    forever()
}

fn forever() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
