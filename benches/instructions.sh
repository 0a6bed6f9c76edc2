#!/usr/bin/env bash
# How many instructions does a surfel take? Counted by callgrind on small fixed runs, so the same on a busy machine.
#
#   benches/instructions.sh            compare with benches/instructions.txt
#   benches/instructions.sh --update   count and write that file
#
# CURVOX names the command to count; without it the release build is made and counted. Whole runs on one thread,
# from the file to the Parquet table; counts repeat within some 1e-4.
#
# Exit code 1 if a run takes TOLERANCE per cent more than the file says. Fewer instructions are told, not an error:
# refresh the file then, so that they are not lost again.
#
# Counts compare only between machines with the same kind of instructions, which the file names: another kind is
# not checked. valgrind knows no AVX-512, so this counts what machines with AVX2 run; time on a machine with more is for
# `cargo bench`. Nor does a count know of memory and caches: it tells that something has changed, not what it costs.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

TOLERANCE=5
recorded=benches/instructions.txt

update=false
case ${1:-} in
"") ;;
--update) update=true ;;
*)
    echo "usage: $0 [--update]" >&2
    exit 2
    ;;
esac

if ! command -v valgrind >/dev/null 2>&1; then
    echo "NOT CHECKED: valgrind is not installed, no instructions were counted"
    exit 0
fi

# The instructions that `src/simd/dispatch.rs` looks for.
level() {
    local feature
    [ "$(uname -m)" = x86_64 ] || {
        uname -m
        return
    }
    for feature in avx2 bmi1 bmi2 abm popcnt; do
        grep -qw "$feature" /proc/cpuinfo || {
            echo x86-64
            return
        }
    done
    echo x86-64-avx2
}

level=$(level)
known=$(sed -n 's/^level //p' "$recorded")
if [ "$update" = false ] && [ -n "$known" ] && [ "$known" != "$level" ]; then
    echo "NOT CHECKED: $recorded was counted with $known, this machine has $level"
    exit 0
fi

if [ -z "${CURVOX:-}" ]; then
    cargo build --release --quiet
    CURVOX=${CARGO_TARGET_DIR:-target}/release/curvox
fi
work=$(mktemp -d)
trap 'rm -rf -- "$work"' EXIT
"$CURVOX" shape goursat --gridstep 0.5 -o "$work/smooth.vol"
"$CURVOX" shape goursat --gridstep 0.5 --noise 0.1 -o "$work/noise.vol"
head -c $((256 * 256 * 256)) /dev/zero >"$work/empty.raw"

# Name, items, instructions of a run.
count() {
    local name=$1 unit=$2 items
    shift 2
    set -- run "$@" --threads 1 --overwrite -o "$work/out"
    if [ "$unit" = surfel ]; then
        items=$("$CURVOX" "$@" --json 2>/dev/null | sed -n 's/.*"surfels":\([0-9]*\).*/\1/p')
    else
        items=$((256 * 256 * 256))
    fi
    valgrind --tool=callgrind --callgrind-out-file=/dev/null "$CURVOX" "$@" --quiet 2>"$work/log" || {
        cat "$work/log" >&2
        exit 1
    }
    awk -v name="$name" -v unit="$unit" -v items="$items" \
        '/Collected/ { printf "%s %.2f %s\n", name, $NF / items, unit }' "$work/log"
}

{
    for radius in 3vx 6vx; do
        count "default-$radius" surfel "$work/smooth.vol" --threshold 1 --radius $radius
        count "ii-$radius" surfel "$work/smooth.vol" --threshold 1 --radius $radius --normals ii
    done
    count noise-3vx surfel "$work/noise.vol" --threshold 1 --radius 3vx
    count empty voxel "$work/empty.raw" --dims 256,256,256 --dtype u8 --threshold 1
} >"$work/counted"

if [ "$update" = true ]; then
    {
        sed -n '/^#/p' "$recorded"
        echo "level $level"
        echo "compiler $(rustc --version)"
        cat "$work/counted"
    } >"$work/new"
    # Written into, not replaced, so that it keeps its mode.
    cat "$work/new" >"$recorded"
    cat "$recorded"
    exit 0
fi
compiler=$(sed -n 's/^compiler //p' "$recorded")
[ -z "$compiler" ] || [ "$compiler" = "$(rustc --version)" ] ||
    echo "counted before with $compiler, now with $(rustc --version)"
awk -v tolerance="$TOLERANCE" '
    NR == FNR { before[$1] = $2; next }
    !($1 in before) { printf "NOT CHECKED: %s has no count yet (%s a %s)\n", $1, $2, $3; next }
    {
        change = 100 * ($2 / before[$1] - 1)
        verdict = ""
        if (change > tolerance) { verdict = "  WORSE"; worse = 1 }
        printf "%-14s %12.2f a %-6s before %12.2f  %+6.1f %%%s\n", $1, $2, $3, before[$1], change, verdict
    }
    END { exit worse }' "$recorded" "$work/counted"
