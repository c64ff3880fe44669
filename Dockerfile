# split as a command: docker build -t split . && docker run --rm --read-only --tmpfs /tmp -v "$PWD:/data" split --help
FROM python:3.11-slim-bookworm AS build
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY split_cli split_cli
COPY sample_logs sample_logs
RUN python -m venv /opt/split && /opt/split/bin/pip install --no-cache-dir ".[mf4,can]"

FROM python:3.11-slim-bookworm
# A C compiler, so that exported code is compiled and tested on the spot.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends gcc libc6-dev \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 10001 --create-home --shell /usr/sbin/nologin split
COPY --from=build /opt/split /opt/split
# The root may be read-only: what is compiled at run time goes to /tmp.
ENV PATH=/opt/split/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    NUMBA_CACHE_DIR=/tmp/split-numba \
    MPLCONFIGDIR=/tmp/split-matplotlib
USER 10001
WORKDIR /data
ENTRYPOINT ["split"]
CMD ["--help"]
