"""Exported C as others take it: in a sketch, as an Arduino library, by CMake."""

import re
import shutil

import numpy as np
import pytest

from capsyn.errors import ProblemError
from capsyn.exports.export import export
from capsyn.exports.plan import Plan
from support.exports.c_machines import call, need, write
from support.exports.c_plans import files, policy
from support.features import exact

STUB = {
    "Arduino.h": """
#include <stdint.h>
struct Port {
    void begin(long speed);
    void println(double value, int digits = 2);
    void println(long value);
};
extern Port Serial;
extern "C" { void delay(unsigned long ms); unsigned long micros(void); unsigned long millis(void); }
void setup();
void loop();
""",
    "main.cpp": """
#include <Arduino.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <stdlib.h>
Port Serial;
static unsigned long now;
static void put(char c) { while (!(UCSR0A & (1 << UDRE0))) {} UDR0 = (uint8_t)c; }
void Port::begin(long) { UCSR0B = 1 << TXEN0; }
void Port::println(long value) { println((double)value); }
void Port::println(double value, int)
{
    char text[24];
    dtostrf(value, 0, 4, text);
    put('='); for (const char *c = text; *c; ++c) { put(*c); } put('\\n');
}
void delay(unsigned long ms) { now += ms; }
unsigned long micros(void) { return 1000 * now; }
unsigned long millis(void) { return now; }
int main(void)
{
    setup();
    for (uint8_t i = 0; i < 3; ++i) { loop(); }
    cli(); sleep_mode(); for (;;) {}
}
""",
}
"""As much of Arduino's core as the sketches call; its loop ends."""
FLAGS = ["-mmcu=atmega328p", "-Os", "-Wall", "-Wextra", "-Werror", "-I.", "-DARDUINO=10819"]
GARBAGE = ["-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections"]
CATEGORIES = (
    "Display, Communication, Signal Input/Output, Sensors, Device Control, Timing, Data Storage, "
    "Data Processing, Other"
).split(", ")


def run_sketch(sketch, sources, directory, *include):
    """Return what a sketch prints: a copy of it is compiled as C++, as the IDE does."""
    need("avr-gcc", "avr-g++", "simavr")
    write(STUB, directory)
    (directory / "sketch.cpp").write_text(f"#include <Arduino.h>\n{sketch}")
    include = [f"-I{path}" for path in include]
    objects = []
    for source in [*sources, "sketch.cpp", "main.cpp"]:
        plus = str(source).endswith("cpp")
        compiler = ["avr-g++", "-std=gnu++11"] if plus else ["avr-gcc", "-std=gnu11"]
        objects.append(f"{len(objects)}.o")
        command = [*compiler, *FLAGS, *GARBAGE[:2], *include, "-c", str(source), "-o", objects[-1]]
        call(command, directory)
    call(["avr-g++", *FLAGS, *GARBAGE, *objects, "-o", "sketch.elf"], directory)
    told = call(["simavr", "-m", "atmega328p", "-f", "16000000", "sketch.elf"], directory)
    return [float(value) for value in re.findall(r"=(-?\d+\.\d+)", told)]


def test_all_files_of_an_export_in_the_folder_of_a_sketch(tmp_path):
    export(policy("cart-pendulum"), "c", tmp_path / "pendulum", arithmetic="float")
    folder = tmp_path / "pendulum"
    compiled = [p for p in folder.iterdir() if p.suffix in (".c", ".cpp", ".S", ".ino")]
    compiled += (folder / "src").rglob("*.c") if (folder / "src").exists() else []
    assert [path.name for path in compiled] == ["cart_pendulum.c"]
    sketch = """
#include "cart_pendulum.h"
void setup() { Serial.begin(9600); }
void loop() {
  static int16_t symbol = -1;
  Serial.println(cart_pendulum_control(symbol, 0));
  ++symbol;
}
"""
    default, first, second = run_sketch(sketch, compiled, folder)
    controls = policy("cart-pendulum").controls[:, 0]
    assert [first, second, default] == controls.tolist() and len(set(controls)) == 3


@pytest.mark.parametrize(
    "options",
    [
        {"arithmetic": "float", "dwell": 0.1},
        {"arithmetic": "float", "dwell": 0.1, "tick": 0.05},
        {"arithmetic": "lattice"},
        {"arithmetic": "lattice", "dwell": 5.0, "tick": 1e-3},
        {"readings": "int16", "scale": [2 * np.pi / 4096, 0.01], "style": "nested"},
    ],
)
def test_an_arduino_library(tmp_path, options):
    options = dict(options)
    keys = [key for key in ("scale", "dwell") if key in options]
    plan = Plan.of(policy("cart-pendulum"), **{key: options.pop(key) for key in keys})
    written = {
        name.removeprefix("cart_pendulum/"): content
        for name, content in files(plan, None, package="arduino", **options).items()
    }
    assert set(written) == {
        "library.properties",
        "keywords.txt",
        "src/cart_pendulum.h",
        "src/cart_pendulum.c",
        "examples/cart_pendulum/cart_pendulum.ino",
    }
    write(written, tmp_path / "library")
    sketch = written["examples/cart_pendulum/cart_pendulum.ino"].decode()
    source = tmp_path / "library" / "src" / "cart_pendulum.c"
    told = run_sketch(sketch, [source], tmp_path / "build", source.parent)
    middle = plan.policy.domain.lower + plan.policy.domain.widths / 2
    assert told == [plan.policy.controls[plan.policy(middle)][0]] * 3
    assert "cart_pendulum_control(symbol, i)" in sketch
    declared = written["src/cart_pendulum.h"].decode()
    for line in written["keywords.txt"].decode().splitlines():
        word, kind = line.split("\t")
        assert re.search(rf"\b{word}\b", declared) and re.fullmatch("(KEYWORD|LITERAL)[12]", kind)


def test_vectors_and_costs_of_a_library_are_in_its_folder(tmp_path):
    export(policy("cart-pendulum"), "c", tmp_path, package="arduino")
    extras = tmp_path / "cart_pendulum" / "extras"
    assert sorted(path.name for path in extras.iterdir()) == [
        "certificate.json", "golden.csv", "measured.json"
    ]  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["cart_pendulum"]


def test_properties_of_an_arduino_library():
    """They are those of Arduino's library specification 1.5."""
    written = files(Plan.of(policy("cart-pendulum")), None, package="arduino", name="7 of é!")
    (name,) = {path.split("/")[0] for path in written}
    text = written[f"{name}/library.properties"].decode()
    fields = dict(line.split("=", 1) for line in text.splitlines())
    needed = "name version author maintainer sentence paragraph category url architectures".split()
    assert [*fields] == [*needed, "includes"] and all(fields.values())
    assert fields["name"] == name and len(name) <= 63
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9 _.-]*", name) and re.search("[A-Za-z]", name)
    assert re.fullmatch(r"\d+\.\d+\.\d+", fields["version"])
    assert fields["category"] in CATEGORIES and fields["architectures"] == "*"
    assert fields["url"].startswith("https://")
    assert not fields["sentence"].startswith(fields["paragraph"]) and "<" not in text
    assert f"{name}/src/{fields['includes']}" in written
    assert b"\r" not in text.encode() and text.endswith("\n")


USER = """cmake_minimum_required(VERSION 3.14)
project(user C)
{found}
add_executable(user user.c)
target_link_libraries(user PRIVATE cart_pendulum::cart_pendulum)
"""
FETCHED = """include(FetchContent)
FetchContent_Declare(pendulum SOURCE_DIR {source})
FetchContent_MakeAvailable(pendulum)"""
PROGRAM = """
#include <stdio.h>
#include <cart_pendulum.h>
int main(void)
{
    printf("%g %g\\n", cart_pendulum_control(0, 0), cart_pendulum_control(1, 0));
    return 0;
}
"""


@pytest.mark.parametrize("way", ["installed", "installed, of features", "fetched", "subdirectory"])
def test_cmake(tmp_path, way):
    need("cmake", "gcc")
    source, prefix = tmp_path / "source", tmp_path / "installed"
    made = exact() if "features" in way else policy("cart-pendulum")  # that calls cos
    export(made, "c", source)
    found, more = "find_package(cart_pendulum CONFIG REQUIRED)", []
    if "installed" in way:
        call(
            ["cmake", "-S", str(source), "-B", "made", f"-DCMAKE_INSTALL_PREFIX={prefix}"], tmp_path
        )
        call(["cmake", "--build", "made"], tmp_path)
        call(["cmake", "--install", "made"], tmp_path)
        shutil.rmtree(source)
        shutil.rmtree(tmp_path / "made")
        more = [f"-DCMAKE_PREFIX_PATH={prefix}"]
    elif way == "fetched":
        found = FETCHED.format(source=source)
    else:
        found = f"add_subdirectory({source} pendulum)"
    write({"CMakeLists.txt": USER.format(found=found), "user.c": PROGRAM}, tmp_path / "user")
    call(["cmake", "-S", "user", "-B", "build", "--warn-uninitialized", *more], tmp_path)
    call(["cmake", "--build", "build"], tmp_path)
    first, second = policy("cart-pendulum").controls[:2, 0]
    assert call(["build/user"], tmp_path) == f"{first:g} {second:g}\n"


def test_a_package_that_is_not_known():
    plan = Plan.of(policy("cart-pendulum"))
    with pytest.raises(ProblemError, match="`package` must be .*cmake.*arduino"):
        files(plan, None, package="conan")
