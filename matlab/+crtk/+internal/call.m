function value = call(request)
%CALL  Pass a request to the Python client and return its answer.
%   Everything that goes to Python goes through here, as text.
%   Errors are those of the client: crtk:Refused, crtk:Timeout, crtk:ConnectionLost, ...
%   The client answers within 0.1 s, if only with "not yet", so that Ctrl-C works while it waits.

    answer = ask(request);
    while isfield(answer, 'pending')
        answer = ask(struct('do', 'poll', 'pending', answer.pending));
    end
    if isfield(answer, 'error')
        error(answer.error.identifier, '%s', answer.error.message);
    end
    value = answer.value;
end

function answer = ask(request)
    persistent executable
    try
        if isempty(executable)
            environment = pyenv();
            py.importlib.import_module('crtk_drivers.client.matlab');
            executable = char(environment.Executable);
        end
        text = char(py.crtk_drivers.client.matlab.call(jsonencode(request), executable));
    catch cause
        error('crtk:Python', ['Python, or crtk_drivers in it, cannot be used: %s\n' ...
            'See which Python it is with: pyenv. Install crtk-drivers[ros] there, or choose ' ...
            'another one after a restart: pyenv(''Version'', ''/path/to/venv/bin/python'').'], ...
            cause.message);
    end
    answer = jsondecode(text);
end
