function environment = pyenv()
%PYENV  For GNU Octave: the Python that runs the client, from the variable CRTK_PYTHON.

    executable = getenv('CRTK_PYTHON');
    if isempty(executable)
        executable = 'python3';
    end
    environment = struct('Executable', executable);
end
