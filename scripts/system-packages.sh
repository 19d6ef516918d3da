#!/usr/bin/env bash
# The Debian packages that Qt, VTK and open3d need: installed when root, otherwise the exact line to run is printed.
# WITHOUT_SYSTEM_PACKAGES=1 goes on without them, for who cannot have them installed.
# Qt's xcb plugin needs the libxcb ones, VTK the GL ones, open3d libusb, and tests without a screen Xvfb.
set -euo pipefail

packages=(
  python3-venv
  xvfb xauth fonts-dejavu-core
  libgl1 libegl1 libgl1-mesa-dri libglx-mesa0 libegl-mesa0
  libxcb-cursor0 libxcb-icccm4 libxcb-image0 libxcb-keysyms1 libxcb-randr0 libxcb-render-util0
  libxcb-shape0 libxcb-sync1 libxcb-xfixes0 libxcb-xkb1 libxkbcommon-x11-0 libxkbcommon0 libx11-xcb1
  libdbus-1-3 libfontconfig1 libfreetype6 libglib2.0-0 libgomp1 libusb-1.0-0
)

if ! command -v dpkg-query >/dev/null; then
  echo "note: not a Debian system; 'tactoscope doctor' says which libraries are missing" >&2
  exit 0
fi

# What is installed, and what that stands in for: Ubuntu 24.04 and Debian 13 have libglib2.0-0t64 for libglib2.0-0.
installed=" $(dpkg-query -W -f '${db:Status-Status} ${Package}, ${Provides}\n' |
  sed -n 's/^installed //p' | sed 's/([^)]*)//g' | tr -s ',\n' '  ') "

missing=()
for package in "${packages[@]}"; do
  [[ $installed == *" $package "* ]] && continue
  # A Python that brings venv itself does not need Debian's.
  if [[ $package == python3-venv ]] && "${PYTHON:-python3}" -c 'import ensurepip, venv' 2>/dev/null; then continue; fi
  # The name that this release has for it.
  apt-cache show "$package" >/dev/null 2>&1 || ! apt-cache show "${package}t64" >/dev/null 2>&1 || package+=t64
  missing+=("$package")
done
[[ ${#missing[@]} -eq 0 ]] && exit 0

install=(apt-get install -y --no-install-recommends "${missing[@]}")
if [[ $(id -u) -ne 0 ]]; then
  echo "these system packages are missing; run this line, then make again:" >&2
  echo "  sudo apt-get update && sudo ${install[*]}" >&2
  [[ -n ${WITHOUT_SYSTEM_PACKAGES:-} ]] && exit 0
  echo "or go on without them: the window or 3D views may not open (make WITHOUT_SYSTEM_PACKAGES=1)" >&2
  exit 1
fi
export DEBIAN_FRONTEND=noninteractive
apt-get update -qq
"${install[@]}" -qq >/dev/null
