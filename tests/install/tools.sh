#!/usr/bin/env bash
# Install what tests need beyond Python: `make tools`. docs/install.md says what each tool is for.
# On Debian and Ubuntu as root by apt; elsewhere the line to type is printed. Nothing is done for what is there already.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

missing=()
lacks() { command -v "$1" > /dev/null || missing+=("$2"); }
chromium=chromium
if grep -qs '^ID=ubuntu' /etc/os-release; then chromium=chromium-browser; fi
command -v chromium-browser google-chrome > /dev/null || lacks chromium "$chromium"
lacks node nodejs
lacks npm npm
if [ "$(uname)" = Linux ]; then
  lacks strace strace
  [[ $(PATH=$PATH:/usr/sbin:/sbin ldconfig -p) == *libusb-1.0.so* ]] || missing+=(libusb-1.0-0)
fi

if [ ${#missing[@]} -gt 0 ]; then
  if command -v apt-get > /dev/null && [ "$(id -u)" = 0 ]; then
    apt-get update --quiet=2
    DEBIAN_FRONTEND=noninteractive apt-get install --quiet=2 --yes --no-install-recommends "${missing[@]}"
  elif command -v apt-get > /dev/null; then
    echo "missing tools; type: sudo apt-get install ${missing[*]}, then make tools again" >&2
    exit 1
  else
    echo "missing tools; install with your package manager (on macOS: brew install node; brew install --cask chromium): ${missing[*]}" >&2
    exit 1
  fi
fi

for module in gltf-validator three @sparkjsdev/spark; do
  test -d "build/tools/node_modules/$module" || npm install --silent --no-audit --no-fund --prefix build/tools "$module"
done
