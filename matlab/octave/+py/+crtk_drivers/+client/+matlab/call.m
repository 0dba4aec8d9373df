function answer = call(request, executable)
%CALL  For GNU Octave, which cannot call Python: the same text, over a pipe to the same process.

    persistent input output
    if isempty(input)
        [input, output] = popen2(executable, {'-P', '-m', 'crtk_drivers.client.matlab.server'});
    end
    fputs(input, [request "\n"]);
    fflush(input);
    answer = '';
    start = tic;
    while isempty(answer) || answer(end) ~= "\n"
        piece = fgets(output);
        if ischar(piece)
            answer = [answer piece];
        elseif toc(start) > 30.0
            input = output = [];
            error('crtk:ConnectionLost', '%s gave no answer within 30 s: did it end?', executable);
        else
            fclear(output);
            pause(0.0005);
        end
    end
end
