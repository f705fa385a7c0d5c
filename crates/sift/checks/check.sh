#!/bin/sh
# Checks that need more than `cargo test`: other processors, an interpreter, a sanitizer, a fuzzer.
set -u
cd "$(dirname "$0")/.."

usage() {
    cat <<'TEXT'
usage: check.sh neon | miri [LEVEL...] | asan | fuzz [SECONDS]

neon   the crate's tests as 64-bit ARM, emulated (qemu-user, gcc for aarch64)
miri   the engine on a small image, and the matcher, interpreted; levels: scalar avx2 avx512 (default: scalar avx2).
       Miri does not know all of AVX-512: there only the matcher
asan   the crate's tests with AddressSanitizer
fuzz   any bytes through everything, for SECONDS (default 3600)

A check whose tools are missing says `skipped` and succeeds.
TEXT
}

skip() {
    echo "skipped: $1"
    exit 0
}

needs() {
    command -v "$1" >/dev/null 2>&1 || skip "$1 is not installed ($2)"
}

nightly_with() {
    needs rustup "rustup.rs"
    rustup component list --toolchain nightly --installed 2>/dev/null | grep -q "^$1" ||
        skip "nightly has no $1 (rustup component add --toolchain nightly $1)"
}

neon() {
    needs qemu-aarch64 "Debian: qemu-user"
    needs aarch64-linux-gnu-gcc "Debian: gcc-aarch64-linux-gnu"
    [ -d "$(rustc --print sysroot)/lib/rustlib/aarch64-unknown-linux-gnu" ] ||
        skip "no such target (rustup target add aarch64-unknown-linux-gnu, or Debian: libstd-rust-dev:arm64)"
    CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
        CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64 -L /usr/aarch64-linux-gnu" \
        cargo test --release -p scopeservo-sift --target aarch64-unknown-linux-gnu --no-fail-fast --lib --tests
}

miri() {
    nightly_with miri
    for level in "${@:-scalar}"; do
        case $level in
        scalar) features= ;;
        # What the tokens of fearless_simd ask for: Miri has what the compiler is told.
        avx2) features="-Ctarget-cpu=x86-64-v3" ;;
        avx512) features="-Ctarget-cpu=icelake-server" ;;
        *) usage && exit 2 ;;
        esac
        for test in "--test interpreter" "--lib matching"; do
            if [ "$level $test" = "avx512 --test interpreter" ]; then continue; fi
            # shellcheck disable=SC2086
            SIFT_LEVEL=$level RUSTFLAGS="$features" \
                MIRIFLAGS="-Zmiri-disable-isolation -Zmiri-ignore-leaks -Zmiri-permissive-provenance" \
                cargo +nightly miri test -p scopeservo-sift $test || exit 1
        done
    done
}

asan() {
    nightly_with rust-src
    # Leaks are not what it is for: thread pools end with the process.
    RUSTFLAGS=-Zsanitizer=address ASAN_OPTIONS=detect_leaks=0 \
        cargo +nightly test -Zbuild-std --target x86_64-unknown-linux-gnu -p scopeservo-sift --lib --tests
}

fuzz() {
    needs cargo-fuzz "cargo install cargo-fuzz --locked"
    cargo +nightly fuzz run everything -- -max_total_time="${1:-3600}" -max_len=2048 -timeout=300
}

case ${1:-} in
neon | asan | fuzz) "$@" ;;
miri)
    shift
    if [ $# -eq 0 ]; then set -- scalar avx2; fi
    miri "$@"
    ;;
-h | --help) usage ;;
*)
    usage >&2
    exit 2
    ;;
esac
