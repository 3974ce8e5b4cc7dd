# docker build -t magyc-gtsam . && docker run --rm -v "$PWD:/data" magyc-gtsam calibrate dive.mcap
FROM python:3.12 AS wheel
COPY . /src
RUN pip wheel --no-cache-dir --no-deps -w /wheel /src

FROM python:3.12-slim
COPY --from=wheel /wheel /wheel
COPY .ci/container.txt /wheel/
RUN pip install --no-cache-dir -c /wheel/container.txt "$(ls /wheel/*.whl)[px4,ardupilot]" && rm -rf /wheel
WORKDIR /data
ENTRYPOINT ["magyc-gtsam"]
CMD ["--help"]
